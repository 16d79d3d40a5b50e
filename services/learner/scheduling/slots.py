"""A slot: its position in the batch, the actor that holds it, and the state its environments go on from."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from common.wire.messages import Environment


class Refusal(NamedTuple):
    """The reason why a rollout is not used: `slug` is counted, `text` is for a person."""

    slug: str
    text: str


@dataclass
class Member:
    """The actor that holds a slot. `next_seq` is the number of the next rollout; smaller ones are duplicates."""

    incarnation: str
    generation: int
    physics: str
    state: str = "compiling"
    state_s: float = 0.0
    heard_s: float = 0.0
    version: int = 0
    env_steps: int = 0
    steps_per_s: float = 0.0
    next_seq: int = 0

    @property
    def ready(self) -> bool:
        return self.state != "compiling"


@dataclass(frozen=True)
class Start:
    """The generation of the slot's environments and the number of their next rollout.

    `environment` is the `Environment` message of their state; None where they start anew, which `generation` decides.
    """

    generation: int
    seq: int = 0
    environment: bytes | None = None

    @classmethod
    def of(cls, data: bytes) -> Start:
        """The start described by an `Environment` message; CodecError where `data` is none."""
        kept = Environment.decode(data)
        return cls(kept.generation, kept.seq, data)


@dataclass
class Slot:
    """A position in the batch and its actor, if it has one; `given` counts how often it was assigned.

    `start` is where its next holder goes on, until that has delivered a rollout; None for new environments.
    `released`: the wait for an actor that has yet to come is over.
    """

    number: int
    given: int = 0
    member: Member | None = None
    start: Start | None = None
    released: bool = False

    @property
    def reserved(self) -> bool:
        """True if the slot's work may not be given to other actors: which rollout it contributes is determined."""
        return not self.released and (self.given == 0 or self.start is not None)

    @property
    def covered(self) -> bool:
        """True if its rollout will come without another slot's actor: it has a working actor, or is reserved.

        A compiling actor counts only while its slot is reserved, or is the first in it: the others must not wait for
        a successor that compiles.
        """
        if self.reserved or self.member is None:
            return self.reserved
        return (self.member.generation == 0 and not self.released) or self.member.ready


@dataclass
class Counts:
    """Events since the start, by kind: shown, logged and asserted on."""

    refused: Counter[str] = field(default_factory=Counter)
    repeated: int = 0
    joined: int = 0
    lost: int = 0


REMEMBERED = 4096


class Departed:
    """The incarnations that have lost their slots and may not come back: the newest `REMEMBERED` of them.

    A run of months sees any number of incarnations, so the oldest are forgotten.
    """

    def __init__(self) -> None:
        self._incarnations: dict[str, None] = {}

    def __contains__(self, incarnation: str) -> bool:
        return incarnation in self._incarnations

    def __len__(self) -> int:
        return len(self._incarnations)

    def add(self, incarnation: str) -> None:
        self._incarnations[incarnation] = None
        if len(self._incarnations) > REMEMBERED:
            del self._incarnations[next(iter(self._incarnations))]
