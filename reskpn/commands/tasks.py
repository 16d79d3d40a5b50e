"""`reskpn tasks`: all tasks with their family, sizes and control time step."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass

from common.config.settings import RunSettings
from common.errors import ReskpnError
from common.printable import printable
from common.tasks import GYMNASIUM, TASKS, Task, find_task, installed_tasks
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.settings_options import own_task

EPILOG = f"""\
paper: the tasks of the paper, from brax. gymnasium: those of Gymnasium's fifth
version, for comparison with the literature. installed: of packages that have
them as entry points of reskpn.tasks. A class of your own is named module:Class;
`reskpn doctor --task module:Class` examines it.

{EXIT_CODES}"""


@dataclass(frozen=True)
class Row:
    """A task of the table; sizes and seconds are None where it cannot be loaded, and `fault` says why."""

    name: str
    family: str
    observation: int | None
    action: int | None
    step_s: float | None
    episode: int | None
    fault: str = ""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("own", nargs="*", metavar="MODULE:CLASS", help="tasks of your own to list as well")
    parser.add_argument("--json", action="store_true", help="print one JSON list, for machines")


def run(given: argparse.Namespace) -> int:
    """Print the table. Returns 0."""
    rows = [_built_in(task, "paper") for task in TASKS.values()]
    rows += [_built_in(task, "gymnasium") for task in GYMNASIUM.values()]
    rows += [_own(name, "installed") for name in installed_tasks()]
    rows += [_own(name, "own") for name in given.own]
    if given.json:
        print(json.dumps([asdict(row) for row in rows]))
        return 0
    width = max(len(row.name) for row in rows)
    print(f"{'task':{width}}  {'family':9}  observation  action  step (s)  episode")
    for row in rows:
        sizes = (
            f"{row.observation:11}  {row.action:6}  {row.step_s:8g}  {row.episode:7}" if not row.fault else row.fault
        )
        print(f"{printable(row.name):{width}}  {row.family:9}  {printable(sizes, 500)}")
    return 0


def _built_in(task: Task, family: str) -> Row:
    from common.physics.models import step_seconds

    size = task.observation_size, task.action_size
    return Row(task.name, family, *size, step_seconds(task.name), task.episode_length)


def _own(name: str, family: str) -> Row:
    """The row of a task of somebody's own. One that is broken is a row as well: the others are still of use."""
    from common.physics.models import step_seconds

    try:
        settings = own_task(RunSettings(task=name), name)
        task = find_task(name, settings.task_pin)
        size = task.observation_size, task.action_size
        return Row(name, family, *size, step_seconds(name), settings.episode_length)
    except (ReskpnError, ValueError) as error:
        return Row(name, family, None, None, None, None, " ".join(str(error).split()))


COMMAND = Command(add_options, run, EPILOG, usage="reskpn tasks [MODULE:CLASS ...] [--json]")
