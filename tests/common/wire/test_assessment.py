"""What an evaluator may say, and what is refused of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from common.errors import CodecError
from common.wire import codec
from common.wire.assessment import MAX_EPISODES, MAX_POSITIONS, Assessment


def assessment(**changes: Any) -> Assessment:
    values: dict[str, Any] = {
        "run": "run-1", "evaluator": "5f", "version": 3, "step_s": 0.04,
        "episode_return": np.float32([10, 30]), "episode_length": np.int32([3, 7]),
        "qpos": np.float32([[0, 1], [2, 3]]),
    }  # fmt: skip
    return Assessment(**values | changes)


def reason(given: Assessment) -> str:
    with pytest.raises(CodecError) as caught:
        Assessment.decode(given.encode())
    return caught.value.reason


def test_an_assessment_comes_back_as_it_was_sent() -> None:
    """Every field, bit for bit."""
    sent = assessment()
    found = Assessment.decode(sent.encode())
    for name in ("run", "evaluator", "version", "step_s"):
        assert getattr(found, name) == getattr(sent, name)
    for name in ("episode_return", "episode_length", "qpos"):
        np.testing.assert_array_equal(getattr(found, name), getattr(sent, name), strict=True)


def test_positions_may_be_left_out() -> None:
    """As an array without rows."""
    assert Assessment.decode(assessment(qpos=np.zeros((0, 2), np.float32)).encode()).qpos.shape == (0, 2)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"episode_return": np.float32([])}, "bad_shape"),
        ({"episode_return": np.float32([]), "episode_length": np.int32([])}, "bad_shape"),
        ({"episode_return": np.float32([np.nan, 1])}, "not_finite"),
        ({"episode_length": np.int32([0, 7])}, "bad_value"),
        ({"qpos": np.float32([[0, np.inf]])}, "not_finite"),
        ({"qpos": np.zeros((4, 2), np.float32)}, "bad_shape"),  # the first episode has 3 steps
        ({"qpos": np.zeros(4, np.float32)}, "bad_shape"),
        ({"step_s": -1.0}, "bad_value"),
        ({"evaluator": "a/b"}, "bad_value"),
        ({"evaluator": "*"}, "bad_value"),
        ({"run": ""}, "bad_value"),
    ],
)
def test_what_does_not_fit_together_is_refused(changes: dict[str, Any], expected: str) -> None:
    """With its reason."""
    assert reason(assessment(**changes)) == expected


def test_its_size_is_bounded() -> None:
    """What the log is to hold of one evaluation is small, whatever an evaluator would like."""
    many = MAX_EPISODES + 1
    assert reason(assessment(episode_return=np.ones(many, np.float32), episode_length=np.ones(many, np.int32))) == (
        "bad_shape"
    )
    long = np.int32([2**31 - 1, 1])
    rows = MAX_POSITIONS // 2
    allowed = assessment(episode_length=long, qpos=np.zeros((rows, 2), np.float32))
    assert len(Assessment.decode(allowed.encode()).qpos) == rows
    assert reason(assessment(episode_length=long, qpos=np.zeros((rows + 1, 2), np.float32))) == "bad_shape"


def test_rows_without_columns_are_bounded_too() -> None:
    """They cost no bytes on the wire, and would cost a row each in the log."""
    fields = codec.decode(assessment(episode_length=np.int32([2**31 - 1, 1])).encode())
    fields["qpos"] = np.zeros((MAX_POSITIONS + 1, 0), np.float32)
    with pytest.raises(CodecError, match="allowed: 32,768 numbers"):
        Assessment.decode(codec.encode(fields))
