"""A slot: a place in the batch, who holds it, and where its environments go on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from common.wire.messages import Environment, PushReply

Place = tuple[int, int, int]
"""Slot, generation and seq: where a rollout stands in the batch."""

RolloutKey = tuple[int, str, int]
"""Slot, incarnation and seq: `Rollout.key`."""

Objection = tuple[str, str]
"""Why a rollout is not used: the reason that is counted, and a text for a person."""

ACCEPTED = PushReply("accepted", "")


@dataclass
class Member:
    """The actor that holds a slot. `next_seq` counts the rollouts taken from it, to know a repeat by."""

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
        """The start that a message says; CodecError where it is none."""
        kept = Environment.decode(data)
        return cls(kept.generation, kept.seq, data)


@dataclass
class Slot:
    """A place in the batch and who holds it, if anyone; `given` counts how often it was given out.

    `start` is where its next holder goes on, until that has brought a rollout; None for new environments.
    `excused`: the batch waits no longer for who has yet to come.
    """

    number: int
    given: int = 0
    member: Member | None = None
    start: Start | None = None
    excused: bool = False

    @property
    def awaited(self) -> bool:
        """Whether no other slot's actor may do its work, since what it will bring is settled."""
        return not self.excused and (self.given == 0 or self.start is not None)

    @property
    def manned(self) -> bool:
        """Whether its rollout will come without another slot's actor: someone is in it, or is waited for.

        One who compiles counts only where he is waited for: a successor does not hold up the others.
        """
        if self.awaited or self.member is None:
            return self.awaited
        return (self.member.generation == 0 and not self.excused) or self.member.ready


@dataclass
class Counts:
    """What happened since the start, by kind: shown, logged and asserted on."""

    refused: Counter[str] = field(default_factory=Counter)
    repeated: int = 0
    joined: int = 0
    lost: int = 0
