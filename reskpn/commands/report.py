"""`reskpn report`: runs as one HTML page."""

from __future__ import annotations

import argparse
from pathlib import Path

from reskpn.commands.command import EXIT_CODES, Command

EPILOG = f"""\
The page holds everything it shows, so it can be sent and opened anywhere. A run that is not finished is shown as far
as its log goes.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run directory, its log or one .mcap file")
    parser.add_argument("--out", type=Path, default=Path("report.html"), metavar="FILE", help="default: %(default)s")


def run(given: argparse.Namespace) -> int:
    """Write the page; returns exit code 0."""
    from reskpn.study.drawing.tables import write_text
    from reskpn.study.recorded import read_run
    from reskpn.study.report.page import page

    written = write_text(given.out, page([read_run(path) for path in given.runs]))
    print(f"{written}: {written.stat().st_size / 1024:,.0f} KiB")
    return 0


COMMAND = Command(add_options, run, EPILOG, usage="reskpn report RUN... [options]")
