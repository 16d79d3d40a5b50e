"""What a learner answers when it is asked how the run is going: the whole picture, as JSON, in one answer.

All `..._s` are seconds and count up to the moment of the answer, by the learner's clock; nobody else's is needed to
read them. A field that this side does not know is ignored, so that a report of a newer release can be read as well.
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from common.errors import CodecError
from common.printable import printable

MAX_REPORT_BYTES = 4 << 20

Number = Annotated[float, Field(allow_inf_nan=False)]
LONGEST = 4096
"""Characters of a text."""

Line = Annotated[str, Field(max_length=LONGEST)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class ActorReport(_Part):
    """One actor that holds a slot: what it last told, and what became of the rollouts it pushed."""

    slot: int
    generation: int
    incarnation: Line
    host: Line
    state: Line
    state_s: Number
    physics: Line
    version: int
    snapshot_age_s: Number | None
    """Seconds since the version it works with was published; None where that is too long ago to be known."""
    env_steps: int
    steps_per_s: Number
    heard_s: Number
    """Seconds since its last heartbeat."""
    accepted: int
    refused: int
    busy: int
    repeated: int


class VacancyReport(_Part):
    """A slot without an actor, and since when."""

    slot: int
    lost: bool
    """Whether it had an actor before."""
    for_s: Number


class RefusalReport(_Part):
    """The newest message that was not used, for whoever looks for the reason."""

    kind: Line
    reason: Line
    text: Line
    ago_s: Number


class Totals(_Part):
    """Since the learner's start: what became of all rollouts pushed, and how often actors came and went."""

    accepted: int = 0
    refused: int = 0
    busy: int = 0
    repeated: int = 0
    joined: int = 0
    lost: int = 0


class Progress(_Part):
    """How far the run is; None where a number is not known yet."""

    phase: Line
    text: Line
    version: int
    updates: int
    env_steps: int
    total_steps: int
    steps_per_s: Number | None
    train_return: Number | None
    step_reward: Number | None = None
    """Mean reward of a step of the newest batch."""
    staleness: Number
    told_s: Number
    """Seconds since the learner's loop last told this."""


class EvaluationReport(_Part):
    """The newest evaluation that an evaluator brought. Returns are of deterministic episodes."""

    version: int
    env_steps: int
    episodes: int
    return_mean: Number
    return_std: Number
    length_mean: Number
    source: Line
    """The evaluator, with the beginning of its incarnation."""
    behind: int
    """Versions published after this one by now."""
    ago_s: Number


class RunReport(_Part):
    """The run at one moment."""

    run: Line
    task: Line
    learner: Line
    endpoint: Line
    t_ns: int
    """Unix time of the answer."""
    up_s: Number
    progress: Progress | None
    """None in the first moments of a learner."""
    waiting_for: Line
    rollouts_there: int
    slots: int
    actors: list[ActorReport]
    vacancies: list[VacancyReport]
    totals: Totals
    refusals: dict[str, dict[str, int]]
    """Messages that were not used: kind of message -> reason -> count."""
    turned_away: dict[str, int]
    """Actors that asked to join and got no slot, by reason; one that stands by asks again and again."""
    last_refusal: RefusalReport | None
    evaluators: int = 0
    """Evaluators that are here."""
    evaluation: EvaluationReport | None = None

    def encode(self) -> bytes:
        return self.model_dump_json().encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Raises `CodecError`: `too_large`, or `bad_value` for what is not a report."""
        if len(data) > MAX_REPORT_BYTES:
            raise CodecError("too_large", f"a report of {len(data):,} bytes; {MAX_REPORT_BYTES:,} are allowed")
        try:
            return cls.model_validate_json(data)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = printable(".".join(map(str, first["loc"])), 80)
            raise CodecError(
                "bad_value",
                f"this is not the report of a learner ({where}: {first['msg']}): run the same release on both sides",
            ) from None
