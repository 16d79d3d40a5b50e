"""The result of a verification, as sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from common.runs.origins import BITS_DEPEND_ON, Difference
from services.replay.verify import (
    ABSOLUTE_TOLERANCE,
    RELATIVE_TOLERANCE,
    Divergence,
    MetricDifference,
    Verdict,
)

TOLERANCE = f"within {ABSOLUTE_TOLERANCE:g} + {RELATIVE_TOLERANCE:.0%} of the recorded value"


def describe_verdict(verdict: Verdict, found: Sequence[Difference]) -> Iterator[str]:
    """The verdict as lines: what agreed and how, the first divergence, and what differs from the machine of the run."""
    if verdict.agrees:
        yield f"all {verdict.updates} updates agree{_how(verdict)}"
    elif verdict.divergence is not None:
        yield from _divergence(verdict, verdict.divergence)
    if verdict.tolerance_from is not None:
        yield (
            f"FALLBACK: from update {verdict.tolerance_from} on the states differ in their bits, and only the metrics "
            f"were compared, each {TOLERANCE}; equal bits are promised on the same device and versions only"
        )
        if verdict.tolerance_from > 1:
            yield (
                f"  updates 1 to {verdict.tolerance_from - 1} were equal bit for bit all the same, so unless the run "
                "moved to another machine there, a changed log is likelier than other arithmetic"
            )
    yield from _machine(found)
    if verdict.speed is not None:
        yield f"{verdict.replay_s:.1f} s where the run took {verdict.live_s:.1f} s: {verdict.speed:.2f} times its speed"


def _how(verdict: Verdict) -> str:
    if verdict.tolerance_from is None:
        return ", bit for bit"
    exact = verdict.tolerance_from - 1
    return f": the first {exact} bit for bit, {verdict.updates - exact} in their metrics"


def _divergence(verdict: Verdict, divergence: Divergence) -> Iterator[str]:
    before = f"the {verdict.updates} before it agree{_how(verdict)}" if verdict.updates else "it is the first"
    yield f"update {divergence.version} DIVERGES; {before}"
    yield f"  state digest recorded    {divergence.recorded_digest}"
    yield f"  state digest recomputed  {divergence.recomputed_digest or 'none: the update could not be applied'}"
    if divergence.reason:
        yield f"  {divergence.reason}"
    elif not divergence.metrics:
        yield "  its metrics are the same: the states differ in something that no metric shows"
    else:
        yield from _metrics(divergence.metrics)


def _metrics(metrics: Sequence[MetricDifference]) -> Iterator[str]:
    width = max(len("metric"), *(len(metric.name) for metric in metrics))
    yield f"  {'metric':{width}}  {'recorded':>24}  {'recomputed':>24}"
    for metric in metrics:
        yield f"  {metric.name:{width}}  {_number(metric.recorded):>24}  {_number(metric.recomputed):>24}"


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value!r}"


def _machine(found: Sequence[Difference]) -> Iterator[str]:
    if not found:
        yield "versions, hardware and commit are those of the run"
        return
    yield "not as in the run:"
    for difference in found:
        note = "" if difference.name in BITS_DEPEND_ON else " (does not excuse other bits)"
        yield f"  {difference}{note}"
