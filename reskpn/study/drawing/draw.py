"""All figures and tables of an experiment, out of the results that there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from common.config.settings import RunSettings
from reskpn.study.drawing import tables
from reskpn.study.drawing.curves import draw_curves
from reskpn.study.drawing.spreads import draw_spreads
from reskpn.study.drawing.style import save, style
from reskpn.study.drawing.summary import draw_summary
from reskpn.study.drawing.tables import Table, write_text
from reskpn.study.experiments import Experiment
from reskpn.study.groups import Group, group
from reskpn.study.planning import Plan, plan
from reskpn.study.scoring import area_of, final_of
from reskpn.study.store import Store


@dataclass(frozen=True)
class Drawn:
    """The drawings of an experiment: a caption, picture files by their stem, and tables."""

    name: str
    caption: str
    pictures: list[Path]
    tables: list[Table]


def draw_experiment(
    experiment: Experiment, scale: str, catalogue: Mapping[str, Experiment], store: Store, out: Path
) -> Drawn | None:
    """Draw an experiment into files of its name in `out`; None where it has no results yet.

    Raises:
        SettingsError: results of different versions are mixed.
        LogWriteError: a file cannot be written.
    """
    planned = plan(experiment, scale, catalogue, store)
    groups = [each for each in group(experiment, planned, store) if any(each.results.values())]
    if not groups and experiment.needs_runs:
        return None
    tasks = [task for task in dict.fromkeys(t.settings.task for t in planned.trials) if _has_runs(groups, task)]
    caption = _caption(experiment, scale, planned, store)
    kind = experiment.drawing.kind
    pictures: list[Path] = []
    made: list[Table] = []
    with style():
        if kind == "curves":
            measures = experiment.drawing.measures
            pictures += save(draw_curves(groups, tasks, measures, experiment.drawing.scale), out / experiment.name)
        elif kind == "spreads":
            results = [r for each in groups for runs in each.results.values() for r in runs if r.spreads]
            pictures += save(draw_spreads(results), out / experiment.name)
        elif kind == "scores":
            reference = _reference(experiment, groups)
            made += _score_tables(groups, tasks, reference)
            summary = draw_summary(groups, reference)
            pictures += [] if summary is None else save(summary, out / experiment.name)
        elif kind == "runtimes":
            made.append(tables.runtime_table(groups, tasks))
        else:
            made.append(tables.settings_table(_settings_by_label(experiment, planned)))
    _write_tables(made, out / experiment.name)
    return Drawn(experiment.name, caption, [path for path in pictures if path.suffix == ".svg"], made)


def _score_tables(groups: Sequence[Group], tasks: Sequence[str], reference: Group) -> list[Table]:
    every = [tables.score_table(groups, tasks, final_of), tables.score_table(groups, tasks, area_of)]
    aggregate = tables.aggregate_table(groups, reference)
    return every if aggregate is None else [aggregate, *every]


def _write_tables(made: Sequence[Table], stem: Path) -> None:
    """The tables as numbered files; those of earlier drawings that had more tables are removed."""
    for number, table in enumerate(made, 1):
        for suffix, text in (("csv", table.csv()), ("md", table.markdown())):
            write_text(_numbered(stem, number, suffix), text)
    for suffix in ("csv", "md"):
        number = len(made) + 1
        while (old := _numbered(stem, number, suffix)).exists():
            old.unlink()
            number += 1


def _numbered(stem: Path, number: int, suffix: str) -> Path:
    return stem.with_name(f"{stem.name}.{suffix}" if number == 1 else f"{stem.name}-{number}.{suffix}")


def _reference(experiment: Experiment, groups: Sequence[Group]) -> Group:
    """The arm that others are measured by: the drawing's `reference` where it has runs, else the first that has."""
    by_name = {each.name: each for each in groups}
    return by_name.get(experiment.drawing.reference or "", groups[0])


def _settings_by_label(experiment: Experiment, planned: Plan) -> dict[str, RunSettings]:
    found: dict[str, RunSettings] = {}
    for trial in planned.trials:
        found.setdefault(experiment.arms[trial.arm].label or trial.arm, trial.settings)
    return found


def _has_runs(groups: Sequence[Group], task: str) -> bool:
    return any(each.results.get(task) for each in groups)


def _caption(experiment: Experiment, scale: str, planned: Plan, store: Store) -> str:
    """Title, how many of the runs there are, and how large they are."""
    title = f"{experiment.paper}: {experiment.title}" if experiment.paper else experiment.title
    if not experiment.needs_runs:
        return f"{title}."
    made = sum(store.find(trial.settings) is not None for trial in planned.trials)
    steps = sorted({trial.settings.total_steps for trial in planned.trials})
    length = f"{steps[0]:,}" if len(steps) == 1 else f"{steps[0]:,} to {steps[-1]:,}"
    waiting = f"; not decided yet: {', '.join(planned.undecided)}" if planned.undecided else ""
    return f"{title}. {made} of {len(planned.trials)} runs at scale {scale} ({length} environment steps){waiting}."
