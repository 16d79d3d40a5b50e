"""The style of all pictures, and writing them: the same bytes for the same results."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from common.errors import LogWriteError
from common.remedies import remedy

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#6b4c9a", "#e69f00", "#56b4e9", "#222222")
"""Okabe and Ito's colours, which most people with a colour vision deficiency can tell apart, the yellow darkened."""

DASHES = ("-", "--", "-.", ":")

PANEL_INCHES = (3.3, 2.5)

SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "reskpn",
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "figure.dpi": 110,
    "legend.frameon": False,
}


def line_style(index: int) -> dict[str, Any]:
    """Colour and dash of the line number `index`: no two of the first 32 are alike."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": DASHES[index // len(COLOURS) % len(DASHES)],
    }


@contextmanager
def style() -> Iterator[None]:
    """Pictures made in this block look as this module says."""
    with matplotlib.rc_context(SETTINGS):
        yield


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `stem`.svg and `stem`.png; returns their paths. LogWriteError where they cannot be written."""
    paths = [stem.with_name(stem.name + suffix) for suffix in (".svg", ".png")]
    try:
        stem.parent.mkdir(parents=True, exist_ok=True)
        for path in paths:
            # Without a date, the same results give the same file.
            metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
            figure.savefig(path, metadata=metadata)
    except OSError as error:
        raise LogWriteError(f"{stem} cannot be written ({error.strerror or error}); {remedy(error)} (--out)") from None
    return paths
