"""Environment states that a resumed run could not go on from are refused when they are handed in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from samples import environment_arrays

from common.errors import CodecError
from common.physics.state_shapes import state_shapes
from common.tasks import TASKS
from services.learner.endpoints.environment_checks import EnvironmentChecks

CHECKS = EnvironmentChecks(state_shapes(TASKS["inverted_pendulum"], 2), episode_length=1000)


def changed(path: str, value: Any) -> dict[str, np.ndarray]:
    return environment_arrays() | {path: value}


def test_environments_of_the_run_pass() -> None:
    """Two inverted pendulums (O = 4) in the middle of an episode."""
    CHECKS.check(environment_arrays() | {"steps": np.array([3, 999], np.int32)})


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({}, "bad_fields"),
        ({"q": np.zeros(2, np.float32)}, "bad_fields"),
        (changed("stray", np.zeros(2, np.float32)), "bad_fields"),
        (changed("obs", np.zeros((2, 4), np.float64)), "bad_dtype"),
        (changed("steps", np.zeros(2, np.float32)), "bad_dtype"),
        (changed("obs", np.zeros((2, 5), np.float32)), "bad_shape"),
        (changed("bodies/q", np.zeros((3, 2), np.float32)), "bad_shape"),
        (changed("bodies/qd", np.full((2, 2), np.nan, np.float32)), "not_finite"),
        (changed("first_bodies/q", np.full((2, 2), np.inf, np.float32)), "not_finite"),
        (changed("episode_return", np.full(2, 3e38, np.float32)), "too_big"),
        (changed("steps", np.array([0, 1000], np.int32)), "bad_value"),
        (changed("diverged", np.array([0, -1], np.int32)), "bad_value"),
    ],
)
def test_others_are_refused(arrays: dict[str, np.ndarray], reason: str) -> None:
    """Stray or missing arrays, other dtypes and shapes, and numbers that no simulation goes on from."""
    with pytest.raises(CodecError) as caught:
        CHECKS.check(arrays)
    assert caught.value.reason == reason
