"""Whether a policy can be sampled from, and what becomes of an update whose policy cannot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from samples import rollout, settings

from common.errors import NumericsError
from common.wire.rollout import Rollout
from services.learner.training.sampling import sampling_problem
from services.learner.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("in_a_hurry")


@pytest.mark.parametrize(
    ("log_std", "told"),
    # Eight standard deviations must be within 1e10: log(1e10 / 8) = 20.95. The inverse of the smallest is exp(88.7).
    [
        ([0.0, 20.9], None),
        ([-86.5, 0.0], None),
        ([0.0, 21.0], "action 1 is 21: its standard deviation 1.32e+09 is too large for actions up to 1e+10"),
        ([100.0, 0.0], "action 0 is 100: its standard deviation inf is too large for actions up to 1e+10"),
        ([0.0, -90.0], "is too small for float32"),
    ],
)
def test_the_limits_of_a_standard_deviation(log_std: list[float], told: str | None) -> None:
    """Where a far draw is larger than a rollout may hold, or the inverse is not finite, and which action it is."""
    problem = sampling_problem(np.array(log_std, np.float32))
    if told is None:
        assert problem is None
    else:
        assert problem is not None
        assert told in problem


def trainer(**algorithm: Any) -> Trainer:
    small = {"hidden": (8, 8), "minibatches": 2, "learning_rate": 50.0, "entropy_coefficient": 1.0}
    return Trainer(settings(learner="ppo", algorithm=small | algorithm))


def batch() -> list[Rollout]:
    return [rollout(), rollout(1, "b")]


def test_a_policy_that_cannot_be_sampled_from_is_refused() -> None:
    """As a state that is not finite: not applied, with log_std and the settings that move it.

    Adam's first steps are as long as the learning rate: 8 of 50 take log_std from 0 far beyond 88.7, where its standard
    deviation is infinite in float32.
    """
    learner = trainer()
    digest = learner.digest()
    with pytest.raises(NumericsError) as caught:
        learner.update(batch())
    told = str(caught.value)
    assert "update 1 made a policy that cannot be sampled from; it was not applied. log_std of action 0 is" in told
    assert "algorithm.entropy_coefficient (1) and algorithm.learning_rate (50)" in told
    assert "algorithm.max_log_std" in told
    assert (learner.version, learner.digest()) == (0, digest)


def test_log_std_can_be_bounded() -> None:
    """With a bound of 2 the same update is applied, and |log_std| is 2."""
    learner = trainer(max_log_std=2.0)
    learner.update(batch())
    assert learner.version == 1
    log_std = learner.policy_arrays()["parameters/log_std"]
    np.testing.assert_array_equal(np.abs(log_std), 2.0)
