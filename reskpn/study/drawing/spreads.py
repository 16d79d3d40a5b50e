"""Boxes of the distribution of observations and of learned features, by dimension (the paper's Figure 5a)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reskpn.study.drawing.style import COLOURS
from reskpn.study.results import Result

SIDES = {"observations": "observations (standardised)", "features": "features ψ(o)"}


def draw_spreads(results: Sequence[Result]) -> Figure:
    """Boxes of the quartiles and whiskers to 5 and 95%, the mean over runs, of both sides on one scale."""
    found = {side: np.mean([result.spreads[side] for result in results], axis=0) for side in SIDES}
    widths = [len(found[side]) for side in SIDES]
    figure = Figure(figsize=(7.5, 3.2), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True, width_ratios=[max(width, 5) for width in widths])
    for axis, (side, title), colour in zip(axes, SIDES.items(), COLOURS, strict=False):
        _boxes(axis, found[side], colour)
        axis.set_title(title)
        axis.set_xlabel("dimension")
    axes[0].set_ylabel("value")
    return figure


def _boxes(axis: Axes, quantiles: np.ndarray, colour: str) -> None:
    """One box a row of [5%, 25%, 50%, 75%, 95%]."""
    boxes = [
        {"whislo": low, "q1": q1, "med": median, "q3": q3, "whishi": high, "fliers": []}
        for low, q1, median, q3, high in quantiles
    ]
    axis.bxp(
        boxes,
        positions=list(range(1, len(boxes) + 1)),
        widths=0.6,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.5, "linewidth": 0.8},
        medianprops={"color": "#222222"},
    )
    axis.set_xticks(list(range(1, len(boxes) + 1)))
    axis.set_xticklabels([str(i) for i in range(1, len(boxes) + 1)], fontsize=8)
