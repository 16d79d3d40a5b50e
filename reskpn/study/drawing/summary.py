"""One picture of many runs: interquartile means, probabilities of improvement and performance profiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reskpn.study.drawing.style import line_style
from reskpn.study.drawing.tables import aggregates, comparable
from reskpn.study.groups import Group
from reskpn.study.statistics import (
    Estimate,
    Strata,
    bootstrap,
    improvement,
    interquartile_mean,
    performance_profile,
    pooled,
)


def draw_summary(groups: Sequence[Group], reference: Group) -> Figure | None:
    """Three panels over the tasks that all comparable groups have runs of; None where nothing can be compared."""
    groups, reference = comparable(groups, reference)
    strata = aggregates(groups, reference)
    if strata is None or len(groups) < 2:
        return None
    height = 0.32 * len(groups) + 1.6
    figure = Figure(figsize=(10.5, max(height, 3.0)), layout="constrained")
    means, better, profile = figure.subplots(1, 3, width_ratios=[1.25, 1, 1.25])
    final = strata["final"]
    labels = [each.label for each in groups]
    _intervals(means, labels, [bootstrap(final[each.name], interquartile_mean) for each in groups], 0)
    means.set_xlabel(f"interquartile mean, last tenth\n(untrained 0, {reference.label} 1)")
    others = [each for each in groups if each is not reference]
    chances = [improvement(final[each.name], final[reference.name]) for each in others]
    _intervals(better, [each.label for each in others], chances, [groups.index(each) for each in others])
    better.axvline(0.5, color="#888888", linewidth=0.8)
    better.set_xlim(-0.03, 1.03)
    better.set_xlabel(f"probability of being better\nthan {reference.label}")
    _profiles(profile, groups, final)
    return figure


def _intervals(axis: Axes, labels: Sequence[str], estimates: Sequence[Estimate], colours: int | Sequence[int]) -> None:
    """Each estimate as a point with its interval, the first at the top."""
    for row, estimate in enumerate(estimates):
        colour = line_style(row if isinstance(colours, int) else colours[row])["color"]
        axis.plot(
            [estimate.low, estimate.high], [row, row], color=colour, linewidth=5, alpha=0.35, solid_capstyle="butt"
        )
        axis.plot([estimate.value], [row], "o", color=colour, markersize=5)
    axis.set_yticks(range(len(labels)), labels)
    axis.set_ylim(len(labels) - 0.5, -0.5)


def _profiles(axis: Axes, groups: Sequence[Group], final: Mapping[str, Strata]) -> None:
    """The share of runs above a score, by score. The colours are those of the first panel, whose labels name them."""
    everything = np.concatenate([pooled(final[each.name]) for each in groups])
    thresholds = np.linspace(min(0.0, float(everything.min())), float(everything.max()) * 1.02, 200)
    for row, each in enumerate(groups):
        axis.plot(thresholds, performance_profile(final[each.name], thresholds), linewidth=1.3, **line_style(row))
    axis.set_xlabel("normalised score τ")
    axis.set_ylabel("share of runs above τ")
    axis.set_ylim(-0.02, 1.02)
