"""The standings of the race, from its results: a table, and a picture of the return over wall time."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.race.entrants import ENVIRONMENTS, OTHERS, Entrant, entrant
from benchmarks.race.records import RaceResult
from common.errors import SettingsError
from reskpn.study.drawing.document import Drawn
from reskpn.study.drawing.style import PANEL_INCHES, line_style, save, style
from reskpn.study.drawing.tables import Table, write_text

NAME = "race"
MARKS = (3, 10)
"""Minutes after which the return is told."""

TARGET = 1000.0
"""Return, of tasks where it is reached, to which the time is told."""


def current(results: Sequence[RaceResult]) -> tuple[list[RaceResult], int]:
    """The results of settings and versions as they are now, and the number of the others."""
    kept = [each for each in results if (known := _entrant(each.given)) and known.identity(each.task) == each.identity]
    return kept, len(results) - len(kept)


def draw(results: Sequence[RaceResult], left_out: int, out: Path) -> Drawn | None:
    """Table and picture as files named "race" in `out`; None without results. LogWriteError as files are written."""
    if not results:
        return None
    table = standings(results, left_out)
    write_text(out / f"{NAME}.csv", table.csv())
    write_text(out / f"{NAME}.md", table.markdown())
    with style():
        pictures = save(picture(results), out / NAME)
    tasks = ", ".join(_tasks(results))
    caption = f"Mean training return by wall time. {len(results)} runs; tasks: {tasks}."
    return Drawn(NAME, caption, [path for path in pictures if path.suffix == ".svg"], [table])


def standings(results: Sequence[RaceResult], left_out: int = 0) -> Table:
    """By task and entrant, over seeds: the return after each of `MARKS`, the speed, and the time to `TARGET`."""
    rows = []
    for task in _tasks(results):
        for name in _entrants(results):
            runs = [each for each in results if (each.task, each.entrant) == (task, name)]
            if runs:
                rows.append([task, name, *(_after(runs, mark) for mark in MARKS), _steps(runs), _time_to(runs)])
    header = [
        "task",
        "entrant",
        *(f"return after {mark} min" for mark in MARKS),
        "steps/s",
        f"minutes to {TARGET:,.0f}",
    ]
    return Table(header, rows, _note(results, left_out))


def picture(results: Sequence[RaceResult]) -> Figure:
    """One panel a task: median and range over seeds by minutes since the launch."""
    tasks, names = _tasks(results), _entrants(results)
    columns = min(len(tasks), 3)
    lines = -(-len(tasks) // columns)
    width, height = PANEL_INCHES
    figure = Figure(figsize=(max(width * columns, 5.0), height * lines + 0.5), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axis, task in zip(panels, tasks, strict=False):
        for index, name in enumerate(names):
            _band(axis, [r for r in results if (r.task, r.entrant) == (task, name)], name, index)
        axis.set_title(ENVIRONMENTS[task])
        axis.set_xlabel("minutes since the launch")
        axis.set_ylabel("training return")
    for axis in panels[len(tasks) :]:
        axis.set_visible(False)
    drawn = {label: line for axis in panels for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(drawn.values(), drawn.keys(), loc="outside lower center", ncols=len(drawn))
    return figure


def _band(axis: Axes, runs: Sequence[RaceResult], label: str, index: int) -> None:
    """The median of the runs with their range, where all of them have a return; over the length that all have."""
    if not runs:
        return
    length = min(len(run.curve.time_s) for run in runs)
    times = np.asarray(runs[0].curve.time_s[:length])
    found = np.array([[run.curve.return_at(time) for time in times] for run in runs], np.float64)
    there = ~np.isnan(found).any(axis=0)
    if not there.any():
        return
    look = line_style(index)
    axis.plot(times[there] / 60, np.median(found[:, there], axis=0), label=label, linewidth=1.4, **look)
    low, high = found[:, there].min(axis=0), found[:, there].max(axis=0)
    axis.fill_between(times[there] / 60, low, high, color=look["color"], alpha=0.15, linewidth=0)


def _after(runs: Sequence[RaceResult], minutes: float) -> str:
    """Median (least to greatest) of the return after so many minutes, and the number of runs; of those that lasted."""
    found = [run.curve.return_at(minutes * 60) for run in runs if run.minutes >= minutes]
    return _median([value for value in found if value is not None], "{:,.0f}".format)


def _steps(runs: Sequence[RaceResult]) -> str:
    return _median([run.curve.env_steps[-1] / run.curve.time_s[-1] for run in runs], "{:,.0f}".format)


def _time_to(runs: Sequence[RaceResult]) -> str:
    """Median and range of the minutes to `TARGET`; a run that never got there counts as the longest."""
    times = sorted(run.curve.time_to(TARGET) or float("inf") for run in runs)
    if times[0] == float("inf"):
        return f"not in {max(run.minutes for run in runs):g}"
    return _median([time / 60 for time in times], lambda minutes: f"{minutes:.1f}")


def _median(values: Sequence[float], text: Callable[[float], str]) -> str:
    if not values:
        return "-"
    ends = "" if len(values) == 1 else f" ({text(min(values))} to {text(max(values))})"
    return f"{text(statistics.median(values))}{ends}, {len(values)}".replace("inf", "never")


def _tasks(results: Sequence[RaceResult]) -> list[str]:
    found = {each.task for each in results}
    return [task for task in ENVIRONMENTS if task in found]


def _entrants(results: Sequence[RaceResult]) -> list[str]:
    """Our own first, by name, then the others."""
    names = sorted({each.entrant for each in results})
    return sorted(names, key=lambda name: name in OTHERS)


def _entrant(given: str) -> Entrant | None:
    """The entrant, or None where it is not one any more: its file of settings has gone."""
    try:
        return entrant(given)
    except SettingsError:
        return None


def _note(results: Sequence[RaceResult], left_out: int) -> str:
    cores = sorted({each.cores for each in results})
    machines = sorted({each.machine["cpu"] for each in results})
    days = sorted({each.finished_at[:10] for each in results})
    given = {each.entrant: each.given for each in results}
    whats = [known.what for name in _entrants(results) if (known := _entrant(given[name]))]
    parts = [
        "Median over seeds (least to greatest), number of runs. Return: the mean over the training episodes, with "
        "exploration, that ended in the last tenth of the time until then. Time counts from the launch of the process, "
        "imports and compiling included, without compiled programs of earlier runs. Tasks: Gymnasium's, version 5, "
        "of its package for sb3 and sbx, this project's equal ones where nothing else is said.",
        f"{_list(cores)} cores of {_list(machines)}; {days[0]}" + (f" to {days[-1]}" if days[1:] else "") + ".",
        *(f"{what}." for what in whats),
    ]
    if left_out:
        parts.append(f"{left_out} results of other settings or versions are left out.")
    return " ".join(parts)


def _list(values: Sequence[object]) -> str:
    return ", ".join(str(value) for value in values)
