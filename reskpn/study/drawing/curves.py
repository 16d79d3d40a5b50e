"""Learning curves: a panel a task, a line an arm, the interval of its mean over seeds as a band."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reskpn.study.drawing.style import PANEL_INCHES, line_style
from reskpn.study.groups import Group, series
from reskpn.study.results import NO_EPISODE_ENDS, Result
from reskpn.study.statistics import mean_interval

COLUMNS = 3

NAMES = {
    "return": "return",
    "return_std": "std of return",
    "variance/gradient": "gradient variance (eq. 10)",
    "variance/q_std": "Q",
    "variance/v_std": "V",
    "variance/a_std": "A",
    "variance/a_less_h": "|a - h|",
    "variance/mu": "|μ|",
    "variance/a_less_h_mu": "|a - h - μ|",
}
"""What a measure is called in a picture."""

AXES = {"_std": "standard deviation (scaled rewards)", "variance/": "root mean square (action units)"}
"""The label of an axis with several measures, by a part of their names."""


def draw_curves(groups: Sequence[Group], tasks: Sequence[str], measures: Sequence[str], scale: str) -> Figure:
    """The picture. With several measures, each is a line, and there is a panel for each arm and task."""
    panels = [
        (task, [g]) if len(measures) > 1 else (task, list(groups))
        for task in tasks
        for g in (groups if len(measures) > 1 else groups[:1])
    ]
    columns = min(COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(max(columns * PANEL_INCHES[0], 4.6), rows * PANEL_INCHES[1] + 0.5), layout="constrained")
    axes: list[Axes] = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axis, (task, shown) in zip(axes, panels, strict=False):
        _panel(axis, task, shown, measures, scale)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    _legend(figure, axes)
    return figure


def _legend(figure: Figure, axes: Sequence[Axes]) -> None:
    """Below the panels, where it covers no curve; each name once."""
    handles: dict[str, Artist] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        rows = math.ceil(len(handles) / max(2, int(figure.get_figwidth() / 1.7)))
        columns = math.ceil(len(handles) / rows)
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=columns)


def _panel(axis: Axes, task: str, groups: Sequence[Group], measures: Sequence[str], scale: str) -> None:
    axis.set_title(task)
    axis.set_xlabel("environment steps (millions)")
    axis.set_ylabel(_ylabel(task, measures))
    drawn = False
    for i, each in enumerate(groups):
        for j, measure in enumerate(measures):
            label = each.label if len(measures) == 1 else NAMES.get(measure, measure)
            drawn |= _line(axis, each.results.get(task, []), measure, label, i + j, scale)
    if drawn:
        axis.set_yscale(scale)
    else:
        axis.set_yticks([])
        axis.text(0.5, 0.5, "no values yet", transform=axis.transAxes, ha="center", va="center", color="#666666")


def _ylabel(task: str, measures: Sequence[str]) -> str:
    if len(measures) > 1:
        return next(label for part, label in AXES.items() if part in measures[0])
    if measures[0] == "return" and task in NO_EPISODE_ENDS:
        return "reward of 1,000 steps"
    return NAMES.get(measures[0], measures[0])


def _line(axis: Axes, results: Sequence[Result], measure: str, label: str, index: int, scale: str) -> bool:
    """Draw the mean of the runs and its interval; whether there was anything to draw."""
    grid, runs = common_grid([series(result, measure) for result in results])
    if not len(grid):
        return False
    if scale == "log":
        runs = np.where(runs > 0, runs, np.nan)
    x, y, style = grid / 1e6, runs.mean(axis=0), line_style(index)
    axis.plot(x, y, label=label, linewidth=1.4, marker="o" if len(x) < 3 else None, markersize=4, **style)
    if len(runs) > 1:
        low, high = mean_interval(runs)
        axis.fill_between(x, low, high, color=style["color"], alpha=0.18, linewidth=0)
    return True


def common_grid(curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Curves with points of their own as rows over common ones: those of the first, where all curves have values."""
    present = [(x, y) for x, y in curves if len(x)]
    if not present:
        return np.zeros(0), np.zeros((0, 0))
    low, high = max(x[0] for x, _ in present), min(x[-1] for x, _ in present)
    grid = present[0][0]
    grid = grid[(grid >= low) & (grid <= high)]
    return grid, np.array([np.interp(grid, x, y) for x, y in present])
