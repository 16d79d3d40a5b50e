"""The output of `reskpn compare` and `reskpn sweep`: one picture, one table and the points of the curves."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from reskpn.study.drawing import tables
from reskpn.study.drawing.curves import common_grid, draw_curves
from reskpn.study.drawing.style import save, style
from reskpn.study.drawing.tables import Table, write_text
from reskpn.study.groups import Group, series
from reskpn.study.scoring import area_of, final_of
from reskpn.study.statistics import mean_interval


def draw_side_by_side(groups: Sequence[Group], stem: Path) -> tuple[list[Path], list[Table]]:
    """Write `stem`.svg, .png, .md and .csv; returns the files and the tables of the Markdown.

    Raises:
        LogWriteError: a file cannot be written.
    """
    tasks = list(dict.fromkeys(task for each in groups for task in each.results))
    with style():
        files = save(draw_curves(groups, tasks, ["return"], "linear"), stem)
    made = [tables.score_table(groups, tasks, final_of), tables.score_table(groups, tasks, area_of)]
    aggregate = tables.aggregate_table(groups, groups[0]) if len(groups) > 1 else None
    made += [] if aggregate is None else [aggregate]
    files.append(write_text(stem.with_name(stem.name + ".md"), "\n".join(table.markdown() for table in made)))
    files.append(write_text(stem.with_name(stem.name + ".csv"), curve_points(groups)))
    return files, made


def curve_points(groups: Sequence[Group]) -> str:
    """CSV of the mean return and its 95% interval at every point of the curves."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["group", "task", "env_steps", "return", "low", "high", "runs"])
    for each in groups:
        for task, results in each.results.items():
            grid, runs = common_grid([series(result, "return") for result in results])
            if not len(grid):
                continue
            low, high = mean_interval(runs)
            for row in zip(grid, runs.mean(axis=0), low, high, strict=True):
                writer.writerow([each.name, task, int(row[0]), *(f"{value:.6g}" for value in row[1:]), len(runs)])
    return out.getvalue()
