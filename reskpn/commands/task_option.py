"""`--task` of commands that read a run: the task that it must be of, and leave to import a class of one's own."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from common.errors import SettingsError

if TYPE_CHECKING:
    from common.config.settings import RunSettings


def add_task(parser: argparse.ArgumentParser) -> None:
    """Add `--task`."""
    parser.add_argument(
        "--task",
        metavar="NAME",
        help="the task that it must be of; needed for runs on module:Class, whose code is not run without it",
    )


def confirm_task(settings: RunSettings, task: str | None) -> None:
    """Check that a run is of the task that was given, and allow this process to import it.

    Raises:
        SettingsError: it is of another one.
    """
    if task is None:
        return
    if settings.task != task:
        raise SettingsError(f"--task {task}: the run is of task {settings.task}")
    from common.tasks import is_own

    if is_own(task):
        from common.physics.lookup import allow_import

        allow_import(task)
