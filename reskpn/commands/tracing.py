"""The option `--trace` of commands that run a learner."""

from __future__ import annotations

import argparse

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.trace_plan import TracePlan


def add_trace(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--trace",
        metavar="N[@VERSION]",
        help="trace N updates of the learner with JAX's profiler, from the third on that it makes or from the one that "
        "leads to VERSION, into trace/ in the run's directory, for ui.perfetto.dev",
    )


def trace_plan(given: argparse.Namespace) -> TracePlan | None:
    """The plan that was given; None where none was. SettingsError as `TracePlan.parse`."""
    return None if given.trace is None else TracePlan.parse(given.trace)


def require_reached(plan: TracePlan | None, settings: RunSettings) -> None:
    """Raise SettingsError where the run ends before the first update that is to be traced."""
    if plan is not None and plan.first is not None and plan.first > settings.updates:
        raise SettingsError(
            f"--trace {plan.written()}: the run ends at version {settings.updates}; name an earlier version, or give "
            "more total_steps"
        )
