"""The messages between a learner and its actors and evaluators.

Each is a frozen dataclass: the annotation of a field says what its type is, which values and shapes it may hold, and
how it is read. `Rollout` is in `common.wire.rollout`, `Assessment` in `common.wire.assessment`. Axis letter: e
episodes.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal, Self

import numpy as np

from common.errors import CodecError
from common.printable import quoted
from common.wire.codec import Limits
from common.wire.fields import (
    Amount,
    Count,
    Name,
    PerSlot,
    RunId,
    Slot,
    Text,
    Texts,
    any_array,
    array,
    check_episodes,
    flag,
    mapping,
    one_of,
    text,
)
from common.wire.message import Message
from common.wire.motion import Packed, nothing_packed

MAX_TEXT = 4096
Slug = Annotated[str, text(40, re.compile("[a-z_]*"))]

RESUMING = "resuming"
"""The slug of a refused `JoinReply` where the learner cannot take anyone yet, and soon will."""

FINISHED = "finished"
"""The slug of a refused `JoinReply` where the run is over."""


@dataclass(frozen=True)
class Join(Message):
    """A request to work for a learner. `run` is "" where any run will do. An evaluator is given no slot."""

    LIMITS = Limits(max_message=1 << 18)

    run: Annotated[str, text(80)]
    role: Annotated[Literal["actor", "evaluator"], one_of("actor", "evaluator")]
    incarnation: Name
    versions: Texts
    hardware: Texts
    physics: Name


@dataclass(frozen=True)
class JoinReply(Message):
    """Accepted with a slot and the run's settings as JSON; or refused, `slug` being the reason and `text` a sentence.

    `generation` counts how often this slot was given out before; `final`: repeating the request will not help;
    `restore`: the slot goes on from an environment state that the learner keeps (`Keys.environment`).
    """

    accepted: Annotated[bool, flag]
    slug: Slug
    text: Text
    final: Annotated[bool, flag]
    run: Annotated[str, text(80)]
    slot: Slot
    generation: Count
    settings: Annotated[str, text(1 << 20)]
    restore: Annotated[bool, flag] = False

    @classmethod
    def granted(cls, run: str, slot: int, generation: int, settings: str, *, restore: bool = False) -> Self:
        return cls(True, "", "", False, run, slot, generation, settings, restore)

    @classmethod
    def refused(cls, run: str, slug: str, text: str, *, final: bool) -> Self:
        return cls(False, slug, text[:MAX_TEXT], final, run, 0, 0, "")

    @property
    def finished(self) -> bool:
        """True if the request was refused because the run is over."""
        return self.slug == FINISHED


@dataclass(frozen=True)
class PushReply(Message):
    """The answer to a push: `accepted`, `busy` (send the same later) or `refused`.

    `slug` is the reason to count by, `text` a sentence; both are empty where a push was accepted.
    """

    status: Annotated[Literal["accepted", "busy", "refused"], one_of("accepted", "busy", "refused")]
    slug: Slug = ""
    text: Text = ""

    @classmethod
    def busy(cls, slug: str, text: str) -> Self:
        return cls("busy", slug, text)

    @classmethod
    def refused(cls, slug: str, text: str) -> Self:
        return cls("refused", slug, text[:MAX_TEXT])

    @classmethod
    def of(cls, error: CodecError) -> Self:
        """The refusal of a message that is malformed or not of the right sender."""
        return cls.refused(error.reason, str(error))


ACCEPTED = PushReply("accepted")


@dataclass(frozen=True)
class Orders(Message):
    """The work that the learner wants now; published repeatedly, the last one counts.

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

    OLDEST_SCHEMA = 2

    run: RunId
    version: Count
    digest: Name
    arrays: Annotated[dict[str, np.ndarray], mapping(any_array)]

    @classmethod
    def decode(cls, data: bytes, limits: Limits | None = None) -> Self:
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

    OLDEST_SCHEMA = 2

    run: RunId
    slot: Slot
    incarnation: Name
    generation: Count
    seq: Count
    version: Count
    digest: Name
    arrays: Annotated[dict[str, np.ndarray], mapping(any_array)]

    @classmethod
    def decode(cls, data: bytes, limits: Limits | None = None) -> Self:
        """As `Message.decode`; raises `CodecError("bad_digest")` where arrays and digest disagree."""
        environment = super().decode(data, limits)
        _check_digest(f"environment of slot {environment.slot}", environment.digest, environment.arrays)
        return environment


@dataclass(frozen=True)
class Heartbeat(Message):
    """Sent twice a second: the state of an actor, for how many seconds it has been in it (`state_s`), and its speed."""

    LIMITS = Limits(max_message=1 << 12)

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
    """Returns and lengths of e >= 1 deterministic episodes of one version, and the motions of the first (`pack`)."""

    LIMITS = Limits(max_message=1 << 20)

    run: RunId
    slot: Slot
    incarnation: Name
    version: Count
    episode_return: Annotated[np.ndarray, array("float32", "e")]
    episode_length: Annotated[np.ndarray, array("int32", "e")]
    motions: Packed = field(default_factory=nothing_packed)

    @classmethod
    def decode(cls, data: bytes, limits: Limits | None = None) -> Self:
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
        raise CodecError(
            "bad_digest", f"{what} says digest {quoted(digest)}, but its arrays have {found!r}: fetch it again"
        )
