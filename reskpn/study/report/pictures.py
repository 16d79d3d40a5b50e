"""The pictures of a report, as SVG text to stand within a page."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reskpn.study.drawing.style import line_style, style
from reskpn.study.recorded import RunRecord
from reskpn.study.results import NO_EPISODE_ENDS

WIDTH_INCHES, HEIGHT_INCHES = 6.4, 2.6

LONGEST_OF_TWO = 26
"""Characters of the longest name in a legend of two columns, which is as wide as the picture."""

MOST_POINTS = 400
"""Points of a line: more than a page can show."""


def return_picture(records: Sequence[RunRecord]) -> str:
    """The mean return of the episodes that ended in each update, by environment steps, and the final evaluations."""

    def draw(axis: Axes) -> None:
        for number, record in enumerate(records):
            table, steady = record.curve.table(MOST_POINTS), record.settings.task in NO_EPISODE_ENDS
            column, factor = ("reward", record.settings.episode_length) if steady else ("return", 1)
            _line(axis, table["env_steps"], table[column], record.run, number, factor)
            for each in record.evaluations:
                axis.plot(each["env_steps"] / 1e6, each["return_mean"], "D", markersize=5, **_colour(number))
        axis.set_xlabel("environment steps (millions)")
        axis.set_ylabel("return")

    return _svg(draw, len(records))


def metric_picture(records: Sequence[RunRecord], names: Sequence[str], label: str, scale: str = "linear") -> str | None:
    """Metrics by environment steps; None where no run has any of them."""

    def draw(axis: Axes) -> None:
        number = 0
        for record in records:
            table = record.curve.table(MOST_POINTS)
            for name in (name for name in names if name in table):
                short = name.rpartition("/")[2].replace("_", " ")
                text = f"{record.run}: {short}" if len(records) > 1 else short
                _line(axis, table["env_steps"], table[name], text, number)
                number += 1
        axis.set_xlabel("environment steps (millions)")
        axis.set_ylabel(label)
        axis.set_yscale(scale)

    lines = sum(name in metrics for r in records for name in names for metrics in [r.curve.table(1)])
    return _svg(draw, lines) if lines else None


def timeline_picture(record: RunRecord) -> str:
    """Seconds of each update by phase, stacked, over the time since the first message of the log."""
    # What an actor or the log's thread does goes on beside the phases of the learner's loop.
    phases = [name for name in record.timeline.seconds[0] if "/" not in name and name != "log"]
    step = max(1, len(record.timeline.t_s) // MOST_POINTS)
    chunks = range(0, len(record.timeline.t_s), step)
    times = [record.timeline.t_s[start] for start in chunks]
    heights = [
        [float(np.mean([s.get(name, 0.0) for s in record.timeline.seconds[start : start + step]])) for start in chunks]
        for name in phases
    ]

    def draw(axis: Axes) -> None:
        if len(times) == 1:
            axis.bar(phases, [height[0] for height in heights], color=[_colour(i)["color"] for i in range(len(phases))])
            axis.set_ylabel("seconds of the update")
            return
        axis.stackplot(times, heights, labels=phases, colors=[_colour(i)["color"] for i in range(len(phases))])
        axis.set_xlabel("time (seconds)")
        axis.set_ylabel("seconds of an update")
        axis.set_ylim(bottom=0)

    return _svg(draw, len(phases))


def staleness_picture(records: Sequence[RunRecord]) -> str:
    """Mean staleness of the rollouts of each update, in versions."""

    def draw(axis: Axes) -> None:
        for number, record in enumerate(records):
            values = record.timeline.staleness
            step = max(1, len(values) // MOST_POINTS)
            chunks = range(0, len(values), step)
            steps = [(start + 1.0) * record.settings.batch_size for start in chunks]
            _line(axis, steps, [float(np.mean(values[s : s + step])) for s in chunks], record.run, number)
        axis.set_xlabel("environment steps (millions)")
        axis.set_ylabel("staleness (versions)")
        axis.set_ylim(bottom=-0.05)

    return _svg(draw, len(records))


def _line(
    axis: Axes,
    steps: Sequence[float | None],
    values: Sequence[float | None],
    label: str,
    number: int,
    factor: float = 1.0,
) -> None:
    pairs = [(x / 1e6, factor * y) for x, y in zip(steps, values, strict=True) if x is not None and y is not None]
    if pairs:
        x, y = zip(*pairs, strict=True)
        axis.plot(x, y, label=label, linewidth=1.4, marker="o" if len(x) < 3 else None, **line_style(number))


def _colour(number: int) -> dict[str, Any]:
    return {"color": line_style(number)["color"]}


def _svg(draw: Callable[[Axes], None], lines: int) -> str:
    """The picture that `draw` makes, its legend below it where it would cover no curve."""

    with style():
        figure = Figure(figsize=(WIDTH_INCHES, HEIGHT_INCHES + 0.2 * lines), layout="constrained")
        axis = figure.subplots()
        draw(axis)
        handles, labels = axis.get_legend_handles_labels()
        if handles:
            columns = 2 if max(map(len, labels)) <= LONGEST_OF_TWO else 1
            figure.legend(handles, labels, loc="outside lower center", ncols=columns)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    return text[text.index("<svg") :]
