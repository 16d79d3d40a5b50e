"""The learner's answer to a status request: the whole state of the run, as JSON, in one answer.

All `..._s` are seconds and count up to the moment of the answer, by the learner's clock; nobody else's is needed to
read them. A field that this side does not know is ignored, so that a report of a newer release can be read as well.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, computed_field

from common.errors import CodecError
from common.printable import printable

MAX_REPORT_BYTES = 4 << 20

LATE_S = 1.5
"""An actor not heard from for so long has missed two heartbeats."""

Number = Annotated[float, Field(allow_inf_nan=False)]


def _finite_or_none(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


# A mean may overflow where all of its terms are finite; JSON has no infinity, and one figure must not hide the others.
Known = Annotated[Number | None, BeforeValidator(_finite_or_none)]
"""A figure that is None where it is not known yet, or not finite."""

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
    """The progress of a run at one moment: shown, published and reported."""

    phase: Line
    text: Line
    """What the run waits for; empty where it waits for nothing."""
    version: int
    updates: int
    env_steps: int
    total_steps: int
    steps_per_s: Known
    train_return: Known
    """Mean return of the newest training episodes that ended."""
    step_reward: Known = None
    """Mean reward of a step of the newest batch."""
    staleness: Number
    diverged: int = 0
    """Simulations that diverged since the learner started; each ended an episode."""
    centres: int | None = None
    capacity: int = 0
    """Centres that the representation holds at most; 0 where the learner has none."""
    actors: int = 0
    slots: int = 0
    age_s: Number = 0.0
    """Seconds since the learner's loop reported this."""

    @computed_field  # type: ignore[prop-decorator]
    @property
    def told_s(self) -> float:
        """The former name of `age_s`, for readers of the JSON."""
        return self.age_s

    @property
    def remaining_s(self) -> float | None:
        """Seconds to the end of the run at its present speed; None where that is not known."""
        return (self.total_steps - self.env_steps) / self.steps_per_s if self.steps_per_s else None

    def encode(self) -> bytes:
        return self.model_dump_json().encode()


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
    refused_joins: dict[str, int]
    """Requests to join that got no slot, by reason; an actor that stands by repeats its request."""
    last_refusal: RefusalReport | None
    evaluators: int = 0
    """Evaluators that are here."""
    evaluation: EvaluationReport | None = None

    @computed_field  # type: ignore[prop-decorator]
    @property
    def turned_away(self) -> dict[str, int]:
        """The former name of `refused_joins`, for readers of the JSON."""
        return self.refused_joins

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
