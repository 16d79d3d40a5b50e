"""Trajectories in a message: what comes back, what is cut, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from common.errors import CodecError
from common.wire.divergence import STEPS_BEFORE, Divergence
from common.wire.motion import MAX_MOTION_BYTES, Motion, Motions, nothing_packed, pack, unpack, within


def motion(steps: int) -> Motion:
    """Two positions, one velocity, one action: 5 numbers, so 20 bytes a step."""
    n = np.arange(steps, dtype=np.float32)
    return Motion(np.stack([n, -n], axis=1), n[:, None] + 0.5, n[:, None] * 2, n)


def motions(**changes: Any) -> Motions:
    made = Motions.of([motion(3), motion(2)], run="r", version=4, source="run", step_s=0.5)
    return Motions(**{**vars(made), **changes})


def divergence(steps: int, **changes: Any) -> Divergence:
    made = motion(steps)
    values: dict[str, Any] = {
        "run": "r", "slot": 0, "incarnation": "a", "generation": 0, "seq": 1, "policy_version": 2, "env": 3, "step": 0,
        "step_s": 0.5, "qpos": made.qpos, "qvel": made.qvel, "action": made.action, "reward": made.reward,
    }  # fmt: skip
    return Divergence(**values | changes)


def reason(given: Motions | Divergence) -> str:
    with pytest.raises(CodecError) as caught:
        type(given).decode(given.encode())
    return caught.value.reason


def test_motions_come_back_one_by_one() -> None:
    """Bit for bit, in their order."""
    first, second = Motions.decode(motions().encode()).each()
    for found, sent in ((first, motion(3)), (second, motion(2))):
        for name in ("qpos", "qvel", "action", "reward"):
            np.testing.assert_array_equal(getattr(found, name), getattr(sent, name), strict=True)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"lengths": np.int32([])}, "bad_value"),
        ({"lengths": np.int32([5, 0])}, "bad_value"),
        ({"lengths": np.int32([6, -1])}, "bad_value"),
        ({"lengths": np.int32([3, 3])}, "bad_shape"),
        ({"lengths": np.int32([2**31 - 1, 2**31 - 1])}, "bad_shape"),
        ({"qvel": np.zeros((4, 1), np.float32)}, "bad_shape"),
        ({"qpos": np.full((5, 2), np.nan, np.float32)}, "not_finite"),
        ({"action": np.full((5, 1), 2e10, np.float32)}, "too_big"),
        ({"action": np.zeros((5, 50_000), np.float32)}, "bad_shape"),  # 1,000,000 bytes
        ({"run": ""}, "bad_value"),
        ({"step_s": -1.0}, "bad_value"),
    ],
)
def test_motions_that_are_refused(changes: dict[str, Any], expected: str) -> None:
    """Each for its reason."""
    assert reason(motions(**changes)) == expected


def test_episodes_beyond_the_allowance_are_left_out_and_the_first_is_cut() -> None:
    """At 20 bytes a step: 100 bytes hold 3 steps but not 3 more, and of one episode of 7 steps the first 5."""
    assert [kept.steps for kept in within([motion(3), motion(3)], 100)] == [3]
    assert [kept.steps for kept in within([motion(3), motion(2)], 100)] == [3, 2]
    assert [kept.steps for kept in within([motion(7)], 100)] == [5]
    assert within([motion(3)], 19) == []
    assert within([], 100) == []


def test_what_is_packed_fits_its_message() -> None:
    """However long the episodes: 60,000 steps are 1.2 MB, of which 786,432 bytes, or 39,321 steps, travel."""
    packed = pack([motion(60_000)], run="r", version=4, step_s=0.5)
    found = unpack(packed)
    assert found is not None
    assert found.lengths.tolist() == [MAX_MOTION_BYTES // 20]
    assert packed.nbytes < 1 << 20
    assert unpack(pack([], run="r", version=4, step_s=0.5)) is None
    assert unpack(nothing_packed()) is None


def test_a_divergence_comes_back() -> None:
    """With as many steps as there are before it, and its own."""
    found = Divergence.decode(divergence(STEPS_BEFORE + 1).encode())
    assert found.motion.steps == 51
    np.testing.assert_array_equal(found.qpos, motion(51).qpos, strict=True)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (divergence(0), "bad_shape"),
        (divergence(STEPS_BEFORE + 2), "bad_shape"),
        (divergence(3, qvel=np.zeros((2, 1), np.float32)), "bad_shape"),
        (divergence(3, qpos=np.full((3, 2), np.inf, np.float32)), "not_finite"),
        (divergence(3, env=-1), "bad_value"),
        (divergence(3, slot=True), "bad_type"),
    ],
)
def test_divergences_that_are_refused(given: Divergence, expected: str) -> None:
    """Each for its reason."""
    assert reason(given) == expected
