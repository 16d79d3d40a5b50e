"""The result of a verification, as sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from common.log.chain import ChainCheck
from common.runs.origins import Difference
from common.runs.recorded_run import RecordedRun
from services.replay.beginning import ReplayBeginning, describe_removed
from services.replay.verify import (
    ABSOLUTE_TOLERANCE,
    RELATIVE_TOLERANCE,
    Divergence,
    MetricDifference,
    Verdict,
)

FINDINGS = 20
"""Findings that are printed."""

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
    if verdict.metrics_from is not None:
        yield (
            f"metrics differ from update {verdict.metrics_from} on, while all states are as recorded: the log was "
            "written by another commit, which computed them otherwise"
        )
    yield from _machine(found)
    if verdict.speed is not None:
        yield f"{verdict.replay_s:.1f} s where the run took {verdict.live_s:.1f} s: {verdict.speed:.2f} times its speed"


def describe_retention(run: RecordedRun, begins: ReplayBeginning) -> Iterator[str]:
    """The part of the log that was removed, and what a verification promises without it; nothing for a whole log."""
    if run.whole:
        return
    yield (
        f"{describe_removed(run)}: nothing of them was verified, and neither were updates {run.before.version + 1} to "
        f"{begins.version}, whose rollouts are removed in part or lie before the checkpoint"
    )
    yield (
        f"  what is verified follows from {begins.path}, whose digest the log names for version {begins.version}; that "
        "this state came of a training run is not shown"
    )


def describe_audit(findings: Sequence[str], chain: ChainCheck, *, whole: bool) -> Iterator[str]:
    """The audit and the chain as lines; `whole`: the log was read to its end."""
    for finding in findings[:FINDINGS]:
        yield f"RECORDS DIFFER: {finding}"
    if len(findings) > FINDINGS:
        yield f"... and {len(findings) - FINDINGS} more"
    if not chain.sealed:
        yield (
            "this log has no chain, as those of earlier releases: of its events, evaluations and metadata nothing is "
            "known"
        )
        return
    if chain.findings:
        return
    yield f"the chain holds: {chain.sealed} records name what was written before them{_end(chain, whole)}"
    if chain.first is not None:
        yield f"what came before {chain.first} is not there; the chain was taken up as that file says"


def _end(chain: ChainCheck, whole: bool) -> str:
    if chain.closed:
        return ", and the log was closed"
    if not whole:
        return ""
    return f"; the log was not closed, and its last {chain.unsealed} messages could be cut off unnoticed"


def _how(verdict: Verdict) -> str:
    if verdict.tolerance_from is None:
        return ", bit for bit"
    exact = verdict.tolerance_from - 1
    return f": the first {exact} bit for bit, {verdict.updates - exact} in their metrics"


def _divergence(verdict: Verdict, divergence: Divergence) -> Iterator[str]:
    before = f"the {verdict.updates} before it agree{_how(verdict)}" if verdict.updates else "it is the first"
    yield f"update {divergence.version} DIVERGES; {before}"
    if divergence.recorded_digest == divergence.recomputed_digest:
        yield "  its state is the recorded one, and its metrics are not those that follow from it"
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
        note = "" if difference.excuses_bits else " (does not excuse other bits)"
        yield f"  {difference}{note}"
