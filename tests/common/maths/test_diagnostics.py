"""Metrics of what an update did: distances of features."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_learners import small_learner

from common.config.settings import RunSettings
from common.maths.samples import Pairs, Samples

STEPS, ENVS = 10, 32


def test_the_median_distance_is_that_of_random_pairs() -> None:
    """Environments that stand still, far apart: a transition is never paired with its environment's at another time.

    Ten steps of 32 environments lie in one axis, step after step. Two of 320 rows are of the same environment once in
    35 pairs; the median is that of two different ones.
    """
    settings = RunSettings.model_validate(
        {
            "learner": "origin-kernel",
            "num_envs": ENVS,
            "num_steps": STEPS,
            "actors": 1,
            "total_steps": 10 * ENVS * STEPS,
            "algorithm": {"hidden": (4,), "minibatches": 4},
        }
    )
    small = small_learner(settings, 3, 1)
    rng = np.random.default_rng(0)
    place = rng.standard_normal((ENVS, 3)).astype(np.float32)
    obs = jnp.asarray(np.tile(place, (STEPS, 1)))
    rest = [jnp.asarray(rng.standard_normal(shape), jnp.float32) for shape in ((STEPS * ENVS, 1), *3 * [STEPS * ENVS])]
    batch = Samples(obs, *rest)
    state = small.start
    metrics = jax.jit(small.update.diagnostics)(state, state, batch, Pairs(batch[:0], batch[:0]))
    squared = np.sum((place[:, None] - place[None]) ** 2, axis=2)[np.triu_indices(ENVS, 1)]
    # The median of 160 of them is good to some 10 %.
    assert float(metrics["rkhs/median_distance"]) == pytest.approx(np.median(squared), rel=0.25)
