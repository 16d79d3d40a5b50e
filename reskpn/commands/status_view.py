"""A learner's report as text: a few lines about the run, a table of its slots, and what was refused."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from common.layout import Column, FittedTable, Parts
from common.printable import printable
from common.wire.report import LATE_S, ActorReport, RunReport, VacancyReport

COLUMNS = (
    Column("slot"),
    Column("actor", rank=8, left=True),
    Column("host", rank=3, left=True),
    Column("state", left=True),
    Column("engine", rank=9, left=True),
    Column("policy", rank=1),
    Column("age", rank=6),
    Column("steps/s", rank=1),
    Column("heard", rank=2),
    Column("accepted", rank=4),
    Column("refused", rank=4),
    Column("busy", rank=5),
    Column("repeated", rank=7),
)
"""In a narrow terminal, those with the highest ranks are left out."""


def view(report: RunReport) -> RenderableType:
    """The whole report; text from the network is shown without control characters."""
    return Group(
        *(Parts(line.split(" | ")) for line in head(report)), _table(report), *(Text(line) for line in tail(report))
    )


def head(report: RunReport) -> list[str]:
    """The run: its progress, and what it waits for."""
    name = printable(f"{report.run}: {report.learner} on {report.task} at {report.endpoint}")
    progress = report.progress
    if progress is None:
        return [f"{name}, up {duration(report.up_s)}", f"starting; {_waits(report)}"]
    parts = [
        f"update {progress.version}/{progress.updates}",
        f"steps {progress.env_steps:,}/{progress.total_steps:,}",
        f"steps/s {number(progress.steps_per_s)}",
        f"return {number(progress.train_return, 1)}",
        f"reward {number(progress.step_reward, 2)}",
        f"actors {len(report.actors)}/{report.slots}",
    ]
    parts += [f"diverged {progress.diverged:,}"] if progress.diverged else []
    old = f" (reported {duration(progress.age_s)} ago)" if progress.age_s > 5.0 else ""
    return [
        f"{name}, up {duration(report.up_s)}",
        f"{printable(progress.phase)} | {' | '.join(parts)}{old}",
        _waits(report),
    ]


def _waits(report: RunReport) -> str:
    """The learner's own text takes precedence where it does not wait for rollouts."""
    text = report.progress.text if report.progress is not None else ""
    if report.progress is not None and report.progress.phase in ("compiling", "evaluating"):
        return printable(text, 4096)
    return printable(report.waiting_for, 4096) or "all rollouts have arrived: the learner is computing"


def tail(report: RunReport) -> list[str]:
    """Messages by outcome, and the reasons of refusals."""
    totals = report.totals
    lines = [
        f"rollouts: {totals.accepted:,} accepted, {totals.refused:,} refused, {totals.busy:,} busy, "
        f"{totals.repeated:,} repeated; actors: {totals.joined:,} joined, {totals.lost:,} lost"
    ]
    if (evaluated := _evaluated(report)) is not None:
        lines.insert(0, evaluated)
    if report.refusals:
        kinds = (f"{printable(kind)} {_counts(counts)}" for kind, counts in sorted(report.refusals.items()))
        lines.append(f"not used: {'; '.join(kinds)}")
    if report.refused_joins:
        lines.append(f"joins refused: {_counts(report.refused_joins)}")
    if (last := report.last_refusal) is not None:
        text = printable(f"last, {duration(last.ago_s)} ago: {last.kind} {last.reason}: {last.text}", 400)
        lines.append(text)
    return lines


def _evaluated(report: RunReport) -> str | None:
    """The newest evaluation of an evaluator; None if there is neither."""
    found, here = report.evaluation, f"{report.evaluators:,} evaluator{'' if report.evaluators == 1 else 's'}"
    if found is None:
        return f"evaluation: none yet; {here}" if report.evaluators else None
    behind = f" (-{found.behind:,})" if found.behind > 0 else ""
    return (
        f"evaluation: policy {found.version}{behind}: return {number(found.return_mean, 1)} ± "
        f"{number(found.return_std, 1)} over {found.episodes:,} episodes, {duration(found.ago_s)} ago; {here}"
    )


def _table(report: RunReport) -> FittedTable:
    newest = None if report.progress is None else report.progress.version
    rows = [(actor.slot, actor_row(actor, newest)) for actor in report.actors]
    rows += [(vacancy.slot, vacancy_row(vacancy)) for vacancy in report.vacancies]
    return FittedTable(COLUMNS, [row for _, row in sorted(rows)])


def actor_row(actor: ActorReport, newest: int | None) -> list[str]:
    """The cells of an actor; "-2" after its policy: two versions behind."""
    behind = 0 if newest is None else newest - actor.version
    compiling = actor.state == "compiling"
    version = "-" if compiling else f"{actor.version}{f' (-{behind})' if behind > 0 else ''}"
    age = "-" if compiling or actor.snapshot_age_s is None else duration(actor.snapshot_age_s)
    silent = " SILENT" if actor.heard_s > LATE_S else ""
    return [
        str(actor.slot),
        printable(actor.incarnation[:8]),
        printable(actor.host, 24),
        f"{printable(actor.state, 12)} {duration(actor.state_s)}",
        printable(actor.physics, 8),
        version,
        age,
        number(actor.steps_per_s),
        f"{duration(actor.heard_s)}{silent}",
        *(f"{count:,}" for count in (actor.accepted, actor.refused, actor.busy, actor.repeated)),
    ]


def vacancy_row(vacancy: VacancyReport) -> list[str]:
    """The cells of a slot that no actor holds."""
    why = "lost its actor" if vacancy.lost else "no actor yet"
    return [str(vacancy.slot), "-", "-", f"{why} {duration(vacancy.for_s)}", *["-"] * (len(COLUMNS) - 4)]


def number(value: float | None, decimals: int = 0) -> str:
    """1,234.5; "-" for None, powers of ten beyond a billion."""
    if value is None:
        return "-"
    return f"{value:,.{decimals}f}" if abs(value) < 1e9 else f"{value:.1e}"


def duration(seconds: float) -> str:
    """0.4 s, 12 s, 3 min 05 s, 2 h 10 min; "long" beyond ten thousand hours."""
    if seconds < 10.0:
        return f"{max(0.0, seconds):.1f} s"
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    if seconds < 7200.0:
        return f"{seconds // 60:.0f} min {seconds % 60:02.0f} s"
    if seconds < 3.6e7:
        return f"{seconds // 3600:.0f} h {seconds % 3600 // 60:.0f} min"
    return "long"


def _counts(counts: dict[str, int]) -> str:
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{printable(reason)} {count:,}" for reason, count in ordered)
