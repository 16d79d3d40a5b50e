"""`reskpn compare`: several runs side by side."""

from __future__ import annotations

import argparse
from pathlib import Path

from reskpn.commands.command import EXIT_CODES, Command

EPILOG = f"""\
RUN is a run directory, the result file of `reskpn paper run` or `reskpn sweep`, or a folder of such files. Runs that
differ in seed and task alone are one line, with the 95% interval of its mean over seeds. DIR/compare.svg and .png are
the curves, compare.md has the tables, compare.csv the points of the curves.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run directory, result file or folder")
    parser.add_argument("--out", type=Path, default=Path("build/compare"), metavar="DIR", help="default: %(default)s")


def run(given: argparse.Namespace) -> int:
    """Write picture, tables and points, and print the tables; returns exit code 0."""
    from reskpn.study.comparison import compare, load_results
    from reskpn.study.drawing.side_by_side import draw_side_by_side

    files, tables = draw_side_by_side(compare(load_results(given.runs)), given.out / "compare")
    print("\n".join(table.markdown() for table in tables))
    print(f"{', '.join(file.name for file in files)} in {given.out}")
    return 0


COMMAND = Command(add_options, run, EPILOG, usage="reskpn compare RUN... [options]")
