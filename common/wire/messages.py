"""The messages between a learner and its actors and evaluators.

Each is a frozen dataclass: the annotation of a field says what its type is, which values and shapes it may hold, and
how it is read. Axis letters: T steps of a rollout, N environments, O observation, A action, e episodes that ended,
k episodes among them that the time limit cut.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Literal, Self

import numpy as np

from common.errors import CodecError
from common.wire.codec import LIMITS, Limits
from common.wire.fields import (
    MAX_SLOT,
    any_array,
    array,
    decimal,
    flag,
    integer,
    mapping,
    one_of,
    real,
    require_finite,
    require_shape,
    text,
)
from common.wire.keys import RUN_ID
from common.wire.message import Message

Count = Annotated[int, integer()]
Slot = Annotated[int, integer(0, MAX_SLOT)]
Text = Annotated[str, text(4096)]
Name = Annotated[str, text(128)]
RunId = Annotated[str, text(80, RUN_ID)]
Amount = Annotated[float, real]
Texts = Annotated[dict[str, str], mapping(text(1024))]
PerSlot = Annotated[dict[int, int], mapping(integer(), key=decimal)]
F32TN = Annotated[np.ndarray, array("float32", "T N")]
BoolTN = Annotated[np.ndarray, array("bool", "T N")]

FINISHED = "finished"
"""The slug a `JoinReply`'s reason begins with where the run is over."""


@dataclass(frozen=True)
class Join(Message):
    """May I work for you? `run` is "" where the asker takes any run. An evaluator is given the settings and no slot."""

    run: Annotated[str, text(80)]
    role: Annotated[Literal["actor", "evaluator"], one_of("actor", "evaluator")]
    incarnation: Name
    versions: Texts
    hardware: Texts
    physics: Name


@dataclass(frozen=True)
class JoinReply(Message):
    """Accepted with a slot and the run's settings as JSON, or refused with a reason.

    `generation` counts how often this slot was given out before; `final`: asking again will not help; `restore`: the
    slot goes on from an environment state that the learner keeps (`Keys.environment`).
    """

    accepted: Annotated[bool, flag]
    reason: Text
    final: Annotated[bool, flag]
    run: Annotated[str, text(80)]
    slot: Slot
    generation: Count
    settings: Annotated[str, text(1 << 20)]
    restore: Annotated[bool, flag] = False

    @property
    def finished(self) -> bool:
        """Whether the refusal's reason is that the run is over."""
        return self.reason.startswith(f"{FINISHED}:")


_REAL = (
    *("obs", "action", "log_prob", "reward", "last_obs", "truncated_obs"),
    *("mirror_action", "mirror_reward", "mirror_obs"),
)


@dataclass(frozen=True)
class RolloutShape:
    """The sizes T, N, O, A and m that a run's rollouts have."""

    num_steps: int
    num_envs: int
    observation_size: int
    action_size: int
    branches: int = 0


@dataclass(frozen=True, eq=False)
class Rollout(Message):
    """T steps of N environments under one version of the policy.

    `truncated_obs` are the observations in which the time limit cut an episode, in the order of
    `np.nonzero(truncated)`; `timing` is seconds by phase; `t_ns` is the Unix time of sending. `slot`, `generation` and
    `seq` say which environments acted with which random numbers, whoever the actor was.

    `mirror_...` are the last step made once more with the mirrored action, `mirror_obs` after it; m is N, or 0 in a run
    that does not branch.
    """

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
    timing: Annotated[dict[str, float], mapping(real)]
    mirror_action: Annotated[np.ndarray, array("float32", "m A")]
    mirror_reward: Annotated[np.ndarray, array("float32", "m")]
    mirror_terminated: Annotated[np.ndarray, array("bool", "m")]
    mirror_truncated: Annotated[np.ndarray, array("bool", "m")]
    mirror_obs: Annotated[np.ndarray, array("float32", "m O")]
    generation: Count = 0

    @property
    def key(self) -> tuple[int, str, int]:
        """(slot, incarnation, seq): the same rollout sent twice has the same key."""
        return self.slot, self.incarnation, self.seq

    @property
    def place(self) -> tuple[int, int, int]:
        """(slot, generation, seq): where the rollout stands in a batch. Made again it has the same place."""
        return self.slot, self.generation, self.seq

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        values = (getattr(self, field.name) for field in fields(self))
        return sum(value.nbytes for value in values if isinstance(value, np.ndarray))

    def check(self, shape: RolloutShape) -> None:
        """Raises `CodecError` (`bad_shape`, `bad_value`, `not_finite`) unless the rollout fits the run."""
        steps, envs, obs, action = shape.num_steps, shape.num_envs, shape.observation_size, shape.action_size
        require_shape("obs", self.obs, (steps, envs, obs))
        require_shape("action", self.action, (steps, envs, action))
        for name in ("log_prob", "reward", "terminated", "truncated"):
            require_shape(name, getattr(self, name), (steps, envs))
        require_shape("last_obs", self.last_obs, (envs, obs))
        require_shape("truncated_obs", self.truncated_obs, (int(np.count_nonzero(self.truncated)), obs))
        require_shape("mirror_action", self.mirror_action, (shape.branches, action))
        for name in ("mirror_reward", "mirror_terminated", "mirror_truncated"):
            require_shape(name, getattr(self, name), (shape.branches,))
        require_shape("mirror_obs", self.mirror_obs, (shape.branches, obs))
        if both := np.count_nonzero(self.terminated & self.truncated):
            raise CodecError("bad_value", f"{both} steps that are both terminated and truncated; a step is at most one")
        check_episodes(self.episode_return, self.episode_length)
        ended = np.count_nonzero(self.terminated | self.truncated)
        if self.episode_return.size > ended:
            raise CodecError(
                "bad_shape",
                f"episode_return has {self.episode_return.size} episodes; only {ended} ended here",
            )
        for name in _REAL:
            require_finite(name, getattr(self, name))


@dataclass(frozen=True)
class PushReply(Message):
    """What became of a rollout or an evaluation: `busy` asks for the same again later."""

    status: Annotated[Literal["accepted", "busy", "refused"], one_of("accepted", "busy", "refused")]
    reason: Text


@dataclass(frozen=True)
class Orders(Message):
    """What the learner wants now; said again and again, the last one counts.

    `version`, `digest` and `size` (bytes) are the newest snapshot's; `collect` is rollouts wanted at this version by
    slot, 0 or more for every slot that is held while the run goes on; `evaluate` is episodes by slot. `hand_in`: push
    the state of the environments (`Environment`) before the first rollout of this version.
    """

    run: RunId
    version: Count
    digest: Name
    size: Count
    collect: PerSlot
    evaluate: PerSlot
    finished: Annotated[bool, flag]
    t_ns: Count
    hand_in: Annotated[bool, flag] = False


@dataclass(frozen=True, eq=False)
class Snapshot(Message):
    """One version of the policy as arrays by path; `digest` is `digest_arrays(arrays)`."""

    run: RunId
    version: Count
    digest: Name
    arrays: Annotated[dict[str, np.ndarray], mapping(any_array)]

    @classmethod
    def decode(cls, data: bytes, limits: Limits = LIMITS) -> Self:
        """As `Message.decode`; raises `CodecError("bad_digest")` where arrays and digest disagree."""
        snapshot = super().decode(data, limits)
        _check_digest(f"snapshot {snapshot.version}", snapshot.digest, snapshot.arrays)
        return snapshot


@dataclass(frozen=True, eq=False)
class Environment(Message):
    """The environments of one slot before rollout `seq`, which is the first under policy `version`.

    `arrays` is their whole state by path, of which only an actor knows the meaning; with policy, seed and place it
    decides every rollout that follows.
    """

    run: RunId
    slot: Slot
    incarnation: Name
    generation: Count
    seq: Count
    version: Count
    digest: Name
    arrays: Annotated[dict[str, np.ndarray], mapping(any_array)]

    @classmethod
    def decode(cls, data: bytes, limits: Limits = LIMITS) -> Self:
        """As `Message.decode`; raises `CodecError("bad_digest")` where arrays and digest disagree."""
        environment = super().decode(data, limits)
        _check_digest(f"environment of slot {environment.slot}", environment.digest, environment.arrays)
        return environment


@dataclass(frozen=True)
class Heartbeat(Message):
    """Twice a second: what an actor is doing, for how many seconds (`state_s`), and how fast."""

    run: RunId
    slot: Slot
    incarnation: Name
    state: Annotated[
        Literal["compiling", "waiting", "collecting", "pushing", "evaluating"],
        one_of("compiling", "waiting", "collecting", "pushing", "evaluating"),
    ]
    version: Count
    env_steps: Count
    steps_per_s: Amount
    state_s: Amount
    t_ns: Count


@dataclass(frozen=True, eq=False)
class Evaluation(Message):
    """Returns and lengths of e >= 1 deterministic episodes of one version."""

    run: RunId
    slot: Slot
    incarnation: Name
    version: Count
    episode_return: Annotated[np.ndarray, array("float32", "e")]
    episode_length: Annotated[np.ndarray, array("int32", "e")]

    @classmethod
    def decode(cls, data: bytes, limits: Limits = LIMITS) -> Self:
        """As `Message.decode`; raises `bad_shape` for no episode or unequal lengths, `bad_value`, `not_finite`."""
        evaluation = super().decode(data, limits)
        check_episodes(evaluation.episode_return, evaluation.episode_length)
        if evaluation.episode_return.size == 0:
            raise CodecError("bad_shape", "episode_return has no episode; expected at least one")
        return evaluation


def digest_arrays(arrays: Mapping[str, np.ndarray]) -> str:
    """Hex BLAKE2b-128 of arrays by path: the same on every machine, whatever the order of the map.

    Hashed for each path in order: path, dtype and shape behind their length, then the elements, little-endian and in
    C order. An array that has this layout is not copied.
    """
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(arrays):
        given = np.asarray(arrays[path])
        elements = np.asarray(given, dtype=given.dtype.newbyteorder("<"), order="C")
        header = ascii((path, given.dtype.name, given.shape)).encode()
        digest.update(len(header).to_bytes(4, "little") + header)
        digest.update(elements.data)
    return digest.hexdigest()


def _check_digest(what: str, digest: str, arrays: Mapping[str, np.ndarray]) -> None:
    found = digest_arrays(arrays)
    if found != digest:
        raise CodecError("bad_digest", f"{what} says digest {digest!r}, but its arrays have {found!r}: fetch it again")


def check_episodes(returns: np.ndarray, lengths: np.ndarray) -> None:
    """Raises `CodecError` unless there are as many lengths as returns, each finite, each of a step or more."""
    require_shape("episode_length", lengths, returns.shape)
    require_finite("episode_return", returns)
    if lengths.min(initial=1) < 1:
        raise CodecError("bad_value", f"episode_length has {lengths.min()}; allowed: 1 step or more")
