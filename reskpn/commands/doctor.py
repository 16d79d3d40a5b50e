"""`reskpn doctor`: checks of this machine before a run."""

from __future__ import annotations

import argparse

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
    return doctor(settings, as_json=given.json, full=given.full, joins=given.endpoint is not None)


COMMAND = Command(add_options, run, f"{settings_epilog()}\nThe exit code of `doctor` is 1 if it finds a problem.")
