"""`reskpn learner`: the process that serves a run."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.config.effects import settings_without_effect
from reskpn.commands.command import Command
from reskpn.commands.resuming import AUTO, notify_pending_actors, run_to_resume, settings_to_resume
from reskpn.commands.settings_options import add_settings, settings_epilog, settings_given, settings_given_over


def add_options(parser: argparse.ArgumentParser) -> None:
    add_settings(parser)
    parser.add_argument(
        "--resume",
        metavar=f"RUN_DIR|{AUTO}",
        help=f"continue the unfinished run in that directory; {AUTO}: the one in --run-dir, else the newest one in "
        "runs/ if it has these settings, else start a new run",
    )
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)


def run(given: argparse.Namespace) -> int:
    """Serve the run to its end, or until a signal."""
    from reskpn.supervision.stopping import stopping
    from services.learner.service import run_learner

    over = settings_given_over(given)
    resume = given.resume
    if resume is None or resume == AUTO:
        new = settings_given(given)
        resume = run_to_resume(new) if resume == AUTO else None
    settings = new if resume is None else settings_to_resume(Path(resume), over)
    if settings is not None and (note := settings_without_effect(settings)):
        print(note, flush=True)
    with stopping(supervised=given.supervised) as stop:
        if settings is None:
            return notify_pending_actors(Path(resume), over, stop)
        return run_learner(settings, stop=stop, resume=resume is not None)


COMMAND = Command(add_options, run, settings_epilog())
