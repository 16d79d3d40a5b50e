"""Log-probabilities of a rollout: those of draws pass, a forged one that would overflow the update does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from samples import rollout

from common.errors import CodecError
from common.tasks import TASKS
from common.wire.rollout import Rollout
from services.learner.endpoints.log_probs import (
    LOG_STD,
    VERSIONS,
    LogProbabilityCheck,
    check_log_probs,
    farthest,
)


def drawn(log_std: np.ndarray, mean: float = 0.0, distance: float | None = None) -> Rollout:
    """100 steps of 100 environments, drawn as an actor does in float32; or all of them at that many deviations."""
    rng = np.random.default_rng(0)
    shape = (100, 100, log_std.size)
    noise = rng.standard_normal(shape) if distance is None else np.full(shape, distance)
    std = np.exp(log_std).astype(np.float32)
    action = np.float32(mean) + std * noise.astype(np.float32)
    standardised = (action - np.float32(mean)) / std
    log_prob = (-0.5 * standardised**2 - log_std - 0.5 * math.log(2 * math.pi)).sum(-1)
    return rollout(action=action, log_prob=log_prob.astype(np.float32))


@pytest.mark.parametrize("log_std", [np.zeros(1), np.full(17, -3.0), np.linspace(-8, 4, 7)])
@pytest.mark.parametrize("mean", [0.0, 1e4])
def test_draws_pass(log_std: np.ndarray, mean: float) -> None:
    """Also the farthest that JAX draws in one dimension, and where float32 leaves little of a small deviation."""
    check_log_probs(drawn(log_std, mean), log_std)
    if log_std.size == 1:
        check_log_probs(drawn(log_std, mean, distance=6.0), log_std)


@pytest.mark.parametrize("forged", [-1e4, -130.0, 30.0])
def test_what_no_draw_has_is_refused(forged: float) -> None:
    """Too small, which the update's ratio would overflow by, or larger than the density's peak: 0.92 below 0 here."""
    honest = drawn(np.zeros(1))
    log_prob = honest.log_prob.copy()
    log_prob[7, 3] = forged
    made = rollout(action=honest.action, log_prob=log_prob)
    with pytest.raises(CodecError, match="draws from policy 0 have") as refused:
        check_log_probs(made, np.zeros(1))
    assert refused.value.reason == "bad_log_prob"


def test_the_least_that_passes_does_not_overflow() -> None:
    """The ratio of the density's peak to the least that is let in is finite in float32, for every task."""
    for task in TASKS.values():
        assert math.isfinite(np.exp(np.float32(0.5 * farthest(task.action_size) + 2.0)))


def test_the_newest_policies_are_kept() -> None:
    """As many as staleness can ask for; of others, and of policies that say nothing of it, nothing is checked."""
    check = LogProbabilityCheck()
    for version in range(VERSIONS + 2):
        check.published(version, {LOG_STD: np.full(1, version, np.float32)})
    assert check.log_std(1) is None
    assert check.log_std(VERSIONS + 1) == VERSIONS + 1
    check.published(99, {})
    check_log_probs(rollout(log_prob=np.full((3, 2), -1e9, np.float32)), check.log_std(99))
