"""Re-execution of a recorded run: the learner, fed from the log alone, must arrive at the recorded states."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from common.errors import LogReadError, NumericsError
from common.runs.recorded_updates import RecordedUpdate
from services.learner.training.trainer import Trainer

RELATIVE_TOLERANCE = 0.2
ABSOLUTE_TOLERANCE = 0.05
"""Where bits cannot be expected, |recomputed - recorded| <= absolute + relative * |recorded| for every metric.

About three times what 30 updates of reskpn on inverted_pendulum needed, compiled for SSE 4.2 in place of AVX-512.
"""

LOOP = ("wait", "learner", "publish", "record")
"""The phases in `RecordedUpdate.seconds` that a live learner runs one after the other."""


@dataclass(frozen=True)
class MetricDifference:
    """A metric with two values; None for one that is absent or not finite."""

    name: str
    recorded: float | None
    recomputed: float | None


@dataclass(frozen=True)
class Divergence:
    """The first update that differs from its record.

    `recomputed_digest` is "" where the update could not be applied; `reason` says why then.
    """

    version: int
    recorded_digest: str
    recomputed_digest: str
    metrics: tuple[MetricDifference, ...]
    reason: str = ""


@dataclass(frozen=True)
class Verdict:
    """The result of a verification.

    `updates` agree with their records: those before version `tolerance_from` (None: all) bit for bit, the others in
    their metrics, within the tolerances. `live_s` is the time of the updates in the run and `replay_s` their time here;
    both leave out the first, which waited for compilation. `metrics_from` is the first update whose state agrees but
    not its metrics, which is let pass where another commit computed them; None where there is none.
    """

    updates: int
    tolerance_from: int | None
    divergence: Divergence | None
    live_s: float
    replay_s: float
    metrics_from: int | None = None

    @property
    def agrees(self) -> bool:
        return self.divergence is None

    @property
    def speed(self) -> float | None:
        """Speed as a multiple of the run's; None where there is nothing to compare."""
        return self.live_s / self.replay_s if self.live_s and self.replay_s else None


def verify(
    updates: Iterator[RecordedUpdate],
    trainer: Trainer,
    *,
    allow_other_bits: bool,
    allow_other_metrics: bool = False,
    on_update: Callable[[RecordedUpdate], None],
    clock_s: Callable[[], float] = time.monotonic,
) -> Verdict:
    """Apply the recorded updates in order and compare, up to the first that diverges.

    Args:
        trainer: in the state before the first update, compiled.
        allow_other_bits: where a digest differs, go on with the metrics and their tolerances from there on.
        allow_other_metrics: where a state is the recorded one, let other metrics pass: another commit made them.
        on_update: called after each that agreed.

    Raises:
        LogReadError: of the log, or the first update is not the one after the trainer's state.
    """
    count, tolerance_from, metrics_from, divergence = 0, None, None, None
    live_s, began_s = 0.0, clock_s()
    for update in updates:
        if update.version != trainer.version + 1:
            raise LogReadError(
                f"the log begins with update {update.version}: what came before it is missing, and states can only be "
                "computed from the first; restore the removed segments"
            )
        divergence, same_bits = _compare(update, trainer, allow_other_bits)
        if divergence is not None and same_bits and allow_other_metrics:
            metrics_from, divergence = metrics_from or update.version, None
        if divergence is not None:
            break
        if not same_bits and tolerance_from is None:
            tolerance_from = update.version
        if count:
            live_s += sum(update.seconds.get(phase, 0.0) for phase in LOOP)
        else:
            began_s = clock_s()
        count += 1
        on_update(update)
    return Verdict(count, tolerance_from, divergence, live_s, clock_s() - began_s, metrics_from)


def metric_differences(
    recorded: Mapping[str, float | None], recomputed: Mapping[str, float], *, exact: bool
) -> tuple[MetricDifference, ...]:
    """The metrics that are not the same, or, unless `exact`, not within the tolerances; by name."""
    found = []
    for name in sorted(recorded.keys() | recomputed.keys()):
        old, new = recorded.get(name), _finite(recomputed.get(name))
        if not _equal(old, new, exact) or (name in recorded) != (name in recomputed):
            found.append(MetricDifference(name, old, new))
    return tuple(found)


def _compare(update: RecordedUpdate, trainer: Trainer, allow_other_bits: bool) -> tuple[Divergence | None, bool]:
    """Apply one update; returns its divergence, if any, and True if its state is equal bit for bit."""
    try:
        metrics = trainer.update(update.rollouts)
    except NumericsError as error:
        return Divergence(update.version, update.state_digest, "", (), str(error)), False
    digest = trainer.digest()
    if digest == update.state_digest:
        found = metric_differences(update.metrics, metrics, exact=True)
        return (Divergence(update.version, digest, digest, found) if found else None), True
    if not allow_other_bits:
        found = metric_differences(update.metrics, metrics, exact=True)
        return Divergence(update.version, update.state_digest, digest, found), False
    found = metric_differences(update.metrics, metrics, exact=False)
    return (Divergence(update.version, update.state_digest, digest, found) if found else None), False


def _equal(old: float | None, new: float | None, exact: bool) -> bool:
    if old is None or new is None or exact:
        return old == new
    return abs(new - old) <= ABSOLUTE_TOLERANCE + RELATIVE_TOLERANCE * abs(old)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
