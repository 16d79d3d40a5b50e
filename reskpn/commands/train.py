"""`reskpn train`: a whole run on this machine."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from reskpn.commands.beginning import add_from, origin_settings, refuse_two_beginnings
from reskpn.commands.command import Command
from reskpn.commands.resuming import add_skip_batch, close_log, lock_run, refuse_stray_skip, settings_to_resume
from reskpn.commands.settings_options import add_settings, settings_epilog, settings_given, settings_given_over
from reskpn.commands.tracing import add_trace, require_reached, trace_plan


def add_options(parser: argparse.ArgumentParser) -> None:
    add_settings(parser)
    parser.add_argument("--resume", metavar="RUN_DIR", help="continue the unfinished run in that directory")
    add_skip_batch(parser)
    add_from(parser)
    add_trace(parser)
    parser.add_argument(
        "--dashboard",
        action="store_true",
        help="show the run in the browser: starts `reskpn dashboard` beside it and prints the address",
    )


def run(given: argparse.Namespace) -> int:
    """Train; returns the learner's exit code."""
    from reskpn.supervision.supervisor import train

    trace = trace_plan(given)
    refuse_stray_skip(given)
    refuse_two_beginnings(given)
    if given.origin is not None:
        base = origin_settings(given.origin)
        settings = settings_given_over(given)(base, own_endpoint=False)
        require_reached(trace, settings)
        return train(settings, origin=given.origin, page=given.dashboard, trace=trace)
    if given.resume is None:
        settings = settings_given(given)
        require_reached(trace, settings)
        return train(settings, page=given.dashboard, trace=trace)
    # No process is left that was told the run's former address: a free port is as good.
    over = partial(settings_given_over(given), own_endpoint=False)
    with lock_run(Path(given.resume)) as lock:
        resumed = settings_to_resume(Path(given.resume), over)
        if resumed is None:
            return close_log(Path(given.resume), lock)
        require_reached(trace, resumed)
        return train(resumed, resume=lock, skip_batch=given.skip_batch, page=given.dashboard, trace=trace)


COMMAND = Command(add_options, run, settings_epilog())
