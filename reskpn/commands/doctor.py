"""`reskpn doctor`: checks of this machine before a run."""

from __future__ import annotations

import argparse

from common.config.sources import task_given
from reskpn.commands.command import Command
from reskpn.commands.connection import add_connection, over
from reskpn.commands.settings_options import add_settings, settings_epilog, settings_given


def add_options(parser: argparse.ArgumentParser) -> None:
    add_settings(parser)
    add_connection(parser, what="check for an actor: address of the learner that it will join")
    parser.add_argument("--json", action="store_true", help="print one JSON object, for machines")
    parser.add_argument("--full", action="store_true", help="also compile a step with MJX (up to a minute)")


def run(given: argparse.Namespace) -> int:
    """Print the findings; returns 0, or 1 where there is a problem."""
    from reskpn.doctor.examine import doctor

    settings = settings_given(given)
    settings = settings.model_copy(update={"transport": over(settings.transport, given)})
    task = task_given(given.options, given, config=given.config)
    joins = given.endpoint is not None
    return doctor(settings, as_json=given.json, full=given.full, joins=joins, task=task is not None)


EPILOG = """
With --task (or a file that has one) the task is examined, too: its first states,
a hundred steps, what in its model MJX would simulate otherwise, and, unless
physics is native, both engines beside each other, for which MJX compiles a step
of it (seconds for a pendulum, minutes for a humanoid).
The exit code of `doctor` is 1 if it finds a problem."""

COMMAND = Command(add_options, run, settings_epilog() + EPILOG)
