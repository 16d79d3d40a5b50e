"""`reskpn log`: the log of a run, repaired without resuming the run."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.log.repair import describe_repair, repair
from reskpn.commands.command import EXIT_CODES, Command


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=("repair",), help="close the last file of a log whose learner was killed")
    parser.add_argument("path", type=Path, metavar="RUN", help="directory of a run, or its log directory")


def run(given: argparse.Namespace) -> int:
    """Repair the log and print what was done."""
    lines = describe_repair(repair(given.path))
    for line in lines or [f"{given.path}: every file of the log has its end; nothing was to be repaired"]:
        print(line)
    return 0


COMMAND = Command(add_options, run, EXIT_CODES)
