"""An evaluator's figures for one version of the policy: its message to the learner."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np

from common.errors import CodecError
from common.wire.codec import Limits
from common.wire.fields import MAX_MAGNITUDE, Amount, Count, RunId, array, check_episodes, require_bounded, text
from common.wire.keys import RUN_ID
from common.wire.message import Message
from common.wire.motion import Packed, nothing_packed

MAX_EPISODES = 1024
MAX_POSITIONS = 1 << 15
"""Numbers in `qpos`: as JSON in the log they are a few hundred kB."""


@dataclass(frozen=True, eq=False)
class Assessment(Message):
    """Returns and lengths of e deterministic episodes of one version, and the beginning of the first of them.

    `evaluator` is its incarnation. `qpos` [t, q] are the joint positions before each of the first t steps, `step_s`
    seconds apart; t is 0 where none were kept. `motions` are the first episodes as `pack` makes them.
    """

    LIMITS = Limits(max_message=1 << 20)

    run: RunId
    evaluator: Annotated[str, text(80, RUN_ID)]
    version: Count
    episode_return: Annotated[np.ndarray, array("float32", "e")]
    episode_length: Annotated[np.ndarray, array("int32", "e")]
    qpos: Annotated[np.ndarray, array("float32", "t q")]
    step_s: Amount
    motions: Packed = field(default_factory=nothing_packed)

    @classmethod
    def decode(cls, data: bytes, limits: Limits | None = None) -> Self:
        """As `Message.decode`.

        Raises `CodecError`: `bad_shape` for unequal lengths, for less than one episode or more than `MAX_EPISODES`, and
        for more positions than `MAX_POSITIONS` or than the first episode has steps; `bad_value`, `not_finite`.
        """
        assessment = super().decode(data, limits)
        check_episodes(assessment.episode_return, assessment.episode_length)
        episodes = assessment.episode_return.size
        if not 1 <= episodes <= MAX_EPISODES:
            raise CodecError("bad_shape", f"episode_return has {episodes:,} episodes; allowed: 1 to {MAX_EPISODES:,}")
        _check_positions(assessment.qpos, int(assessment.episode_length[0]))
        return assessment


def _check_positions(qpos: np.ndarray, steps: int) -> None:
    # An array whose rows are empty has no size, but any number of rows.
    if max(qpos.size, len(qpos)) > MAX_POSITIONS or len(qpos) > steps:
        raise CodecError(
            "bad_shape",
            f"qpos has shape {qpos.shape}; allowed: {MAX_POSITIONS:,} numbers, and the {steps:,} steps of the episode",
        )
    require_bounded("qpos", qpos, MAX_MAGNITUDE)
