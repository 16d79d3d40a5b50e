"""`reskpn runs`: the runs of a folder, listed or deleted."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from common.errors import SettingsError
from common.layout import Column, FittedTable
from common.printable import printable
from common.runs.directory import RUNS
from common.runs.listing import ListedRun, describe_run, list_runs
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.status_view import number
from reskpn.doctor.findings import size

PLAIN_WIDTH = 160
COLUMNS = (
    Column("run", left=True),
    Column("task", rank=4, left=True),
    Column("learner", rank=3, left=True),
    Column("seed", rank=5),
    Column("steps"),
    Column("return"),
    Column("state", left=True),
    Column("size", rank=1),
)
"""The name of a run begins with its task, learner and seed unless the user chose another one."""

EPILOG = f"""\
The return is that of the final evaluation, or else of the training. The steps of a
run that has not finished are those up to its newest checkpoint.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--folder", type=Path, default=RUNS, metavar="DIR", help="folder of the runs (default: %(default)s)"
    )
    parser.add_argument(
        "--best", action="store_true", help="of each task and learner only the run with the highest return"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per line, for machines")
    parser.add_argument(
        "--delete", metavar="RUN", help="delete a run, by its name in the folder or its directory, after a question"
    )
    parser.add_argument("--yes", action="store_true", help="with --delete: do not ask")


def run(given: argparse.Namespace) -> int:
    """List the runs, or delete one. Returns 0."""
    if given.delete is not None:
        return delete_run(_directory(given.folder, given.delete), ask=not given.yes)
    try:
        runs = list_runs(given.folder)
    except OSError as error:
        raise SettingsError(
            f"--folder {given.folder} cannot be read ({error.strerror}); give a folder of runs"
        ) from None
    if given.best:
        runs = best_runs(runs)
    if given.json:
        for listed in runs:
            print(json.dumps(asdict(listed) | {"path": str(listed.path)}))
        return 0
    if not runs:
        print(f"no runs in {given.folder}")
        return 0
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=PLAIN_WIDTH)
    console.print(FittedTable(COLUMNS, [row(listed) for listed in runs]))
    return 0


def best_runs(runs: Sequence[ListedRun]) -> list[ListedRun]:
    """The run with the highest return of each task and learner, ordered by both; without a return, none."""
    best: dict[tuple[str, str], ListedRun] = {}
    for listed in runs:
        key = listed.task, listed.learner
        if listed.episode_return is not None and (key not in best or _value(listed) > _value(best[key])):
            best[key] = listed
    return sorted(best.values(), key=lambda listed: (listed.task, -_value(listed)))


def delete_run(run_dir: Path, *, ask: bool) -> int:
    """Delete the directory of a run; with `ask` only after a "y" at the terminal. Returns 0.

    Raises:
        SettingsError: it is not the directory of a run, the run is running, or the files cannot be removed.
    """
    try:
        listed = None if run_dir.is_symlink() else describe_run(run_dir)
    except OSError as error:
        raise SettingsError(f"--delete {run_dir} cannot be read ({error.strerror}); give the name of a run") from None
    if listed is None:
        raise SettingsError(f"--delete {run_dir}: this is not the directory of a run; `reskpn runs` lists them")
    if listed.state == "running":
        raise SettingsError(f"--delete {run_dir}: this run is running; stop it first")
    if ask and not _confirmed(listed):
        print(f"{run_dir} is kept")
        return 0
    try:
        shutil.rmtree(run_dir)
    except OSError as error:
        raise SettingsError(
            f"--delete {run_dir}: {error.filename} cannot be removed ({error.strerror}); check its permissions"
        ) from None
    print(f"{run_dir} is deleted")
    return 0


def row(listed: ListedRun) -> list[str]:
    """The cells of a run."""
    return [
        printable(listed.path.name),
        printable(listed.task, 24),
        printable(listed.learner, 16),
        "-" if listed.seed is None else str(listed.seed),
        number(listed.env_steps),
        number(listed.episode_return, 1),
        listed.state,
        size(listed.size_bytes),
    ]


def _directory(folder: Path, name: str) -> Path:
    """The run of that name in the folder, or else the directory itself."""
    inside = folder / name
    try:
        return inside if "/" not in name and inside.is_dir() else Path(name)
    except OSError:  # a name that is too long, or a folder that cannot be read: the caller says so
        return Path(name)


def _confirmed(listed: ListedRun) -> bool:
    if not sys.stdin.isatty():
        raise SettingsError(f"--delete {listed.path}: there is no terminal to ask at; give --yes as well")
    what = f"{printable(listed.learner)} on {printable(listed.task)}, {number(listed.env_steps)} steps"
    answer = input(f"delete {listed.path} ({what}, {listed.state}, {size(listed.size_bytes)})? [y/N] ")
    return answer.strip().lower() in ("y", "yes")


def _value(listed: ListedRun) -> float:
    return float("-inf") if listed.episode_return is None else listed.episode_return


COMMAND = Command(add_options, run, EPILOG)
