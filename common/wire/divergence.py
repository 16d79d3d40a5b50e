"""A diverged simulation: the step at which it diverged and those before it, as sent to the learner and logged.

Axis letters: k steps, q, v and a the sizes of positions, velocities and actions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np

from common.errors import CodecError
from common.wire.codec import Limits
from common.wire.fields import MAX_MAGNITUDE, Amount, Count, Name, RunId, Slot, array, require_bounded, require_shape
from common.wire.message import Message
from common.wire.motion import Motion

STEPS_BEFORE = 50
"""Steps before the one at which the simulation diverged, unless its episode is shorter."""


@dataclass(frozen=True, eq=False)
class Divergence(Message):
    """The last k steps of an environment before its simulation diverged; the last one led to no state.

    `qpos` and `qvel` are the state before each step and `action` the policy's in it. It was step `step` of rollout
    `seq` of a slot's generation, in environment `env`, under version `policy_version`; `reward` of the last is 0.
    """

    LIMITS = Limits(max_message=1 << 20)
    OLDEST_SCHEMA = 4

    run: RunId
    slot: Slot
    incarnation: Name
    generation: Count
    seq: Count
    policy_version: Count
    env: Count
    step: Count
    step_s: Amount
    qpos: Annotated[np.ndarray, array("float32", "k q")]
    qvel: Annotated[np.ndarray, array("float32", "k v")]
    action: Annotated[np.ndarray, array("float32", "k a")]
    reward: Annotated[np.ndarray, array("float32", "k")]

    @classmethod
    def decode(cls, data: bytes, limits: Limits | None = None) -> Self:
        """As `Message.decode`.

        Raises `CodecError`: `bad_shape` for arrays of different numbers of steps, none, or more than `STEPS_BEFORE`
        and one, `not_finite`, `too_big`.
        """
        divergence = super().decode(data, limits)
        steps = len(divergence.reward)
        if not 1 <= steps <= STEPS_BEFORE + 1:
            raise CodecError("bad_shape", f"reward has {steps:,} steps; allowed: 1 to {STEPS_BEFORE + 1}")
        for name in ("qpos", "qvel", "action", "reward"):
            given: np.ndarray = getattr(divergence, name)
            require_shape(name, given, (steps, *given.shape[1:]))
            require_bounded(name, given, MAX_MAGNITUDE)
        return divergence

    @property
    def motion(self) -> Motion:
        """The steps, to be looked at."""
        return Motion(self.qpos, self.qvel, self.action, self.reward)
