"""`reskpn learner`: the process that serves a run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from common.config.effects import settings_without_effect
from common.config.settings import RunSettings
from common.device_memory import reserve
from common.output import say
from reskpn.commands.beginning import add_from, origin_settings, parse_origin, refuse_two_beginnings
from reskpn.commands.command import Command
from reskpn.commands.resuming import (
    AUTO,
    add_skip_batch,
    lock_run,
    notify_pending_actors,
    refuse_stray_skip,
    run_to_resume,
    settings_to_resume,
)
from reskpn.commands.settings_options import add_settings, settings_epilog, settings_given, settings_given_over
from reskpn.commands.tracing import add_trace, require_reached, trace_plan

if TYPE_CHECKING:
    from services.learner.resume.origin import Origin


def add_options(parser: argparse.ArgumentParser) -> None:
    add_settings(parser)
    parser.add_argument(
        "--resume",
        metavar=f"RUN_DIR|{AUTO}",
        help=f"continue the unfinished run in that directory; {AUTO}: the one in --run-dir, else the newest one in "
        "runs/ if it has these settings, else start a new run",
    )
    add_skip_batch(parser)
    add_from(parser)
    add_trace(parser)
    parser.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--lock-fd", type=int, help=argparse.SUPPRESS)


def run(given: argparse.Namespace) -> int:
    """Serve the run to its end, or until a signal."""
    from reskpn.supervision.stopping import stopping
    from services.learner.service import run_learner

    over, trace = settings_given_over(given), trace_plan(given)
    refuse_stray_skip(given)
    refuse_two_beginnings(given)
    resume = given.resume
    if resume is None or resume == AUTO:
        new = settings_given(given) if given.origin is None else over(origin_settings(given.origin), own_endpoint=False)
        reserve(new.device_memory.learner)
        new = _with_precision_chosen(new)
        resume = run_to_resume(new) if resume == AUTO else None
    with stopping(supervised=given.supervised) as stop:
        if resume is None:
            require_reached(trace, new)
            _print_effects(new)
            return run_learner(new, stop=stop, origin=_origin(given), trace=trace)
        with lock_run(Path(resume), given.lock_fd) as lock:
            settings = settings_to_resume(Path(resume), over)
            if settings is None:
                return notify_pending_actors(Path(resume), over, stop, lock)
            reserve(settings.device_memory.learner)
            require_reached(trace, settings)
            _print_effects(settings)
            return run_learner(settings, stop=stop, resume=True, skip_batch=given.skip_batch, lock=lock, trace=trace)


def _origin(given: argparse.Namespace) -> Origin | None:
    from services.learner.resume.origin import read_origin

    return None if given.origin is None else read_origin(*parse_origin(given.origin))


def _with_precision_chosen(settings: RunSettings) -> RunSettings:
    """The settings with the precision of this machine for `auto`, which the run then keeps wherever it is resumed."""
    if settings.algorithm.precision != "auto":
        return settings
    from common.precision import choose_precision

    precision, reason = choose_precision()
    say(f"algorithm.precision auto is {precision} here: {reason}")
    algorithm = settings.algorithm.model_copy(update={"precision": precision})
    return settings.model_copy(update={"algorithm": algorithm})


def _print_effects(settings: RunSettings) -> None:
    if note := settings_without_effect(settings):
        say(note)


COMMAND = Command(add_options, run, settings_epilog())
