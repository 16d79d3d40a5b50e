"""The rollout: the message that an actor pushes, and what it is made from.

Axis letters: T steps of a rollout, N environments, O observation, A action, e episodes that ended, k episodes among
them that the time limit cut, m mirrored steps.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, NamedTuple

import numpy as np

from common.errors import CodecError
from common.wire.fields import (
    MAX_AMOUNT,
    MAX_MAGNITUDE,
    MAX_RETURN,
    Count,
    Name,
    RunId,
    Slot,
    array,
    check_episodes,
    mapping,
    real,
    require_bounded,
    require_finite,
    require_shape,
    text,
)
from common.wire.message import Message

F32TN = Annotated[np.ndarray, array("float32", "T N")]
BoolTN = Annotated[np.ndarray, array("bool", "T N")]

HEADER_BYTES = 1 << 16
"""More than a rollout takes beside the elements of its arrays: names, timings, dtypes and shapes."""


class RolloutId(NamedTuple):
    """The position of a rollout in a batch; a duplicate, or the same rollout made again, has the same one."""

    slot: int
    generation: int
    seq: int


class RolloutKey(NamedTuple):
    """The identity of a pushed rollout: a rollout that is sent twice by one actor has the same key."""

    slot: int
    incarnation: str
    seq: int


@dataclass(frozen=True)
class RolloutShape:
    """The sizes T, N, O, A and m of a run's rollouts, and the steps after which the time limit cuts an episode."""

    num_steps: int
    num_envs: int
    observation_size: int
    action_size: int
    branches: int = 0
    episode_length: int = 2**31 - 1

    @property
    def max_bytes(self) -> int:
        """The size of the largest rollout message: every step ends an episode that the time limit cuts."""
        steps = self.num_steps * self.num_envs
        per_step = 4 * (self.observation_size + self.action_size + 2) + 2
        per_end = 4 * (self.observation_size + 2)
        per_mirror = 4 * (self.observation_size + self.action_size + 1) + 2
        per_env = 4 * self.observation_size
        cut = min(steps, self.num_envs * (1 + self.num_steps // self.episode_length))
        return (
            steps * per_step + steps * 8 + cut * per_end
            + self.branches * per_mirror + self.num_envs * per_env + HEADER_BYTES
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Rollout(Message):
    """T steps of N environments under one version of the policy.

    `truncated_obs` are the observations in which the time limit cut an episode, in the order of
    `np.nonzero(truncated)`; `timing` is seconds by phase; `t_ns` is the Unix time of sending. `slot`, `generation` and
    `seq` decide which environments acted with which random numbers, whichever actor it was.

    `mirror_...` are the last step made once more with the mirrored action, `mirror_obs` after it; m is N, or 0 in a run
    that does not branch. `diverged` is how many episodes ended since their simulation diverged; 0 in logs of before.
    """

    OLDEST_SCHEMA = 2

    run: RunId
    slot: Slot
    incarnation: Name
    seq: Count
    policy_version: Count
    t_ns: Count
    obs: Annotated[np.ndarray, array("float32", "T N O")]
    action: Annotated[np.ndarray, array("float32", "T N A")]
    log_prob: F32TN
    reward: F32TN
    terminated: BoolTN
    truncated: BoolTN
    last_obs: Annotated[np.ndarray, array("float32", "N O")]
    truncated_obs: Annotated[np.ndarray, array("float32", "k O")]
    episode_return: Annotated[np.ndarray, array("float32", "e")]
    episode_length: Annotated[np.ndarray, array("int32", "e")]
    timing: Annotated[dict[str, float], mapping(real(MAX_AMOUNT), key=text(64))]
    mirror_action: Annotated[np.ndarray, array("float32", "m A")]
    mirror_reward: Annotated[np.ndarray, array("float32", "m")]
    mirror_terminated: Annotated[np.ndarray, array("bool", "m")]
    mirror_truncated: Annotated[np.ndarray, array("bool", "m")]
    mirror_obs: Annotated[np.ndarray, array("float32", "m O")]
    generation: Count = 0
    diverged: Count = 0

    @property
    def key(self) -> RolloutKey:
        return RolloutKey(self.slot, self.incarnation, self.seq)

    @property
    def id(self) -> RolloutId:
        return RolloutId(self.slot, self.generation, self.seq)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        values = (getattr(self, field.name) for field in fields(self))
        return sum(value.nbytes for value in values if isinstance(value, np.ndarray))

    def check(self, shape: RolloutShape) -> None:
        """Raises `CodecError` (`bad_shape`, `bad_value`, `not_finite`) unless the rollout fits the run."""
        self._check_shapes(shape)
        if both := np.count_nonzero(self.terminated & self.truncated):
            raise CodecError("bad_value", f"{both} steps that are both terminated and truncated; a step is at most one")
        check_episodes(self.episode_return, self.episode_length, shape.episode_length)
        if self.diverged > (terminated := np.count_nonzero(self.terminated)):
            raise CodecError("bad_value", f"diverged is {self.diverged}; only {terminated} episodes were terminated")
        ended = np.count_nonzero(self.terminated | self.truncated)
        if self.episode_return.size > ended:
            raise CodecError(
                "bad_shape",
                f"episode_return has {self.episode_return.size} episodes; only {ended} ended here",
            )
        for name, given in self._numbers():
            require_finite(name, given)

    def check_magnitudes(self) -> None:
        """Raises `CodecError("too_big")` for a number that an update could not be computed from.

        Apart from `check`, since a log may hold rollouts from before there was such a bound.
        """
        for name, given in self._numbers():
            require_bounded(name, given, MAX_MAGNITUDE)
        require_bounded("episode_return", self.episode_return, MAX_RETURN)

    def _check_shapes(self, shape: RolloutShape) -> None:
        steps, envs, obs, action = shape.num_steps, shape.num_envs, shape.observation_size, shape.action_size
        require_shape("obs", self.obs, (steps, envs, obs))
        require_shape("action", self.action, (steps, envs, action))
        require_shape("log_prob", self.log_prob, (steps, envs))
        require_shape("reward", self.reward, (steps, envs))
        require_shape("terminated", self.terminated, (steps, envs))
        require_shape("truncated", self.truncated, (steps, envs))
        require_shape("last_obs", self.last_obs, (envs, obs))
        require_shape("truncated_obs", self.truncated_obs, (int(np.count_nonzero(self.truncated)), obs))
        require_shape("mirror_action", self.mirror_action, (shape.branches, action))
        require_shape("mirror_reward", self.mirror_reward, (shape.branches,))
        require_shape("mirror_terminated", self.mirror_terminated, (shape.branches,))
        require_shape("mirror_truncated", self.mirror_truncated, (shape.branches,))
        require_shape("mirror_obs", self.mirror_obs, (shape.branches, obs))

    def _numbers(self) -> tuple[tuple[str, np.ndarray], ...]:
        return (
            ("obs", self.obs),
            ("action", self.action),
            ("log_prob", self.log_prob),
            ("reward", self.reward),
            ("last_obs", self.last_obs),
            ("truncated_obs", self.truncated_obs),
            ("mirror_action", self.mirror_action),
            ("mirror_reward", self.mirror_reward),
            ("mirror_obs", self.mirror_obs),
        )
