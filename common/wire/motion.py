"""Played episodes as they travel and as the log keeps them: joint positions and velocities, actions and rewards.

Axis letters: m episodes, s steps of all of them one after the other, q, v and a the sizes of positions, velocities and
actions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np

from common.errors import CodecError
from common.wire.codec import Limits
from common.wire.fields import (
    MAX_MAGNITUDE,
    Amount,
    Count,
    Name,
    RunId,
    array,
    require_bounded,
    require_shape,
)
from common.wire.message import Message

Packed = Annotated[np.ndarray, array("uint8", "bytes")]
"""An encoded `Motions` as an array of bytes, inside of another message; without elements for none."""

MAX_MOTION_BYTES = 768 << 10
"""Of the arrays of one evaluation's episodes: they travel in a message of at most 1 MiB."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One episode, or its beginning: what was true before each of its t steps, and what the step did.

    Attributes:
        qpos: [t, q] float32 joint positions before the step, as MuJoCo orders them.
        qvel: [t, v] float32 joint velocities before the step.
        action: [t, a] float32 of the policy, not clipped.
        reward: [t] float32 of the step.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    action: np.ndarray
    reward: np.ndarray

    @property
    def steps(self) -> int:
        return len(self.reward)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return self.qpos.nbytes + self.qvel.nbytes + self.action.nbytes + self.reward.nbytes

    def cut(self, steps: int) -> Motion:
        """The first steps alone."""
        return Motion(self.qpos[:steps], self.qvel[:steps], self.action[:steps], self.reward[:steps])


@dataclass(frozen=True, eq=False)
class Motions(Message):
    """The motions of m episodes in one message: `lengths` [m] steps each, their arrays one after the other.

    `version` is that of the policy, `step_s` the simulated seconds of a step. `source` is that of the `/eval` record in
    the log, and "" on the way to the learner.
    """

    LIMITS = Limits(max_message=1 << 20)
    OLDEST_SCHEMA = 4

    run: RunId
    version: Count
    source: Name
    step_s: Amount
    lengths: Annotated[np.ndarray, array("int32", "m")]
    qpos: Annotated[np.ndarray, array("float32", "s q")]
    qvel: Annotated[np.ndarray, array("float32", "s v")]
    action: Annotated[np.ndarray, array("float32", "s a")]
    reward: Annotated[np.ndarray, array("float32", "s")]

    @classmethod
    def of(cls, motions: Sequence[Motion], *, run: str, version: int, source: str, step_s: float) -> Self:
        """One message of at least one motion."""
        return cls(
            run=run,
            version=version,
            source=source,
            step_s=step_s,
            lengths=np.array([motion.steps for motion in motions], np.int32),
            qpos=np.concatenate([motion.qpos for motion in motions]).astype(np.float32, copy=False),
            qvel=np.concatenate([motion.qvel for motion in motions]).astype(np.float32, copy=False),
            action=np.concatenate([motion.action for motion in motions]).astype(np.float32, copy=False),
            reward=np.concatenate([motion.reward for motion in motions]).astype(np.float32, copy=False),
        )

    @classmethod
    def decode(cls, data: bytes, limits: Limits | None = None) -> Self:
        """As `Message.decode`.

        Raises `CodecError`: `bad_shape` for arrays of different numbers of steps or more bytes than
        `MAX_MOTION_BYTES`, `bad_value` for an episode without steps, `not_finite`, `too_big`.
        """
        motions = super().decode(data, limits)
        steps = int(motions.lengths.sum(dtype=np.int64))
        if motions.lengths.size == 0 or motions.lengths.min() < 1:
            raise CodecError("bad_value", "lengths has no episode, or one without steps; every motion has at least one")
        arrays = {"qpos": motions.qpos, "qvel": motions.qvel, "action": motions.action, "reward": motions.reward}
        for name, given in arrays.items():
            require_shape(name, given, (steps, *given.shape[1:]))
            require_bounded(name, given, MAX_MAGNITUDE)
        if (size := sum(given.nbytes for given in arrays.values())) > MAX_MOTION_BYTES:
            raise CodecError("bad_shape", f"motions of {size:,} bytes; allowed: {MAX_MOTION_BYTES:,}")
        return motions

    def each(self) -> Iterator[Motion]:
        """The motions, in their order."""
        ends = np.cumsum(self.lengths).tolist()
        for start, end in zip([0, *ends], ends, strict=False):
            span = slice(start, end)
            yield Motion(self.qpos[span], self.qvel[span], self.action[span], self.reward[span])


def within(motions: Sequence[Motion], budget: int) -> list[Motion]:
    """The first motions, as many as fit into `budget` bytes; if not even one does, its beginning."""
    kept: list[Motion] = []
    for motion in motions:
        if motion.nbytes <= budget:
            kept.append(motion)
            budget -= motion.nbytes
        else:
            steps = 0 if kept or not motion.steps else budget * motion.steps // motion.nbytes
            return [*kept, motion.cut(steps)] if steps else kept
    return kept


def nothing_packed() -> np.ndarray:
    """`Packed` for no motions."""
    return np.zeros(0, np.uint8)


def pack(motions: Sequence[Motion], *, run: str, version: int, step_s: float) -> np.ndarray:
    """The first motions as `Packed`, as many as fit into `MAX_MOTION_BYTES`."""
    kept = within(motions, MAX_MOTION_BYTES)
    if not kept:
        return nothing_packed()
    return np.frombuffer(Motions.of(kept, run=run, version=version, source="", step_s=step_s).encode(), np.uint8)


def unpack(packed: np.ndarray) -> Motions | None:
    """The motions in `packed`; None for none. Raises `CodecError` as `Motions.decode`."""
    return Motions.decode(packed.tobytes()) if packed.size else None
