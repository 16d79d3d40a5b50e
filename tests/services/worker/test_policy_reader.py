"""What a reader of policies knows of a run before it has read one."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from samples import settings

from common.errors import CodecError
from common.maths.trees import to_arrays
from services.learner.training.trainer import Trainer
from services.worker.policy_reader import PolicyReader


def test_shapes_are_those_of_the_learners_policies() -> None:
    """Known without computing a parameter; the initial policy is the learner's, to the last bit."""
    given = settings()
    reader = PolicyReader(given)
    published = Trainer(given).policy_arrays()
    initial = reader.initial()
    assert all(isinstance(leaf, jax.ShapeDtypeStruct) for leaf in jax.tree.leaves(reader.shapes))
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), reader.shapes) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), initial
    )
    mine = to_arrays(initial)
    assert mine.keys() == published.keys()
    for name, array in published.items():
        np.testing.assert_array_equal(mine[name], array)
    read = reader.read(published)
    assert jax.tree.structure(read) == jax.tree.structure(initial)


def test_arrays_of_other_settings_are_refused() -> None:
    """By name and shape."""
    reader = PolicyReader(settings())
    arrays = to_arrays(reader.initial())
    name = next(iter(arrays))
    with pytest.raises(CodecError, match=name):
        reader.read({**arrays, name: np.zeros(3, np.float32)})
