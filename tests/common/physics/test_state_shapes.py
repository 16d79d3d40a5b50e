"""Shapes of environment states from the model alone."""

from __future__ import annotations

import jax
import pytest

from common.maths.trees import to_arrays
from common.physics.environments import make_environment
from common.physics.state_shapes import state_shapes
from common.tasks import TASKS


@pytest.mark.parametrize("task", TASKS)
def test_they_are_those_of_the_environments(task: str) -> None:
    """As traced, without compiling a step: every array of three environments, with dtype and shape."""
    environment = make_environment(task, "native", num_envs=3, threads=1)
    traced = jax.eval_shape(environment.reset, jax.random.key(0))
    empty = jax.tree.map(lambda leaf: jax.numpy.zeros(leaf.shape, leaf.dtype), traced)
    found = {path: (array.dtype.name, array.shape) for path, array in to_arrays(empty).items()}
    assert found == state_shapes(TASKS[task], 3)
