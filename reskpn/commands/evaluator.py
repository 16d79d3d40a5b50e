"""`reskpn evaluator`: the process that evaluates a run's policies while it trains."""

from __future__ import annotations

import argparse
import os

from common.config.faults import PREFIX
from common.config.sources import load
from common.device_memory import adopt, worker_environment
from common.output import say
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.connection import add_worker_options, allow_task, over

EPILOG = f"""\
{PREFIX}TRANSPORT__ENDPOINT, {PREFIX}PHYSICS, {PREFIX}TASK and
{PREFIX}DEVICE_MEMORY__ACTOR in the environment are used as well.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--every",
        type=int,
        default=10,
        metavar="N",
        help="evaluate every N-th version, or the newest if it is already past (default: %(default)s)",
    )
    add("--episodes", type=int, default=16, metavar="N", help="episodes of each policy (default: %(default)s)")
    add(
        "--positions",
        type=int,
        default=200,
        metavar="N",
        help="steps whose joint positions are logged (default: %(default)s)",
    )
    add_worker_options(parser, "follow", "evaluator")


def run(given: argparse.Namespace) -> int:
    """Evaluate until the run is over, or until a signal."""
    base = load(config=given.config)
    physics = given.physics or base.physics
    # JAX looks at the environment when it is imported, so the service is imported after this.
    adopt(worker_environment(os.environ, physics, base.device_memory.actor))

    from reskpn.supervision.stopping import stopping
    from services.evaluator.service import EvaluationOptions, run_evaluator

    allow_task(given, base)
    options = EvaluationOptions(given.every, given.episodes, given.positions, physics, given.threads)
    with stopping(supervised=given.supervised) as stop:
        return run_evaluator(
            over(base.transport, given),
            options,
            run=given.run,
            connect_timeout_s=given.connect_timeout,
            rejoin_timeout_s=given.rejoin_timeout,
            stop=stop,
            say=say,
            state_file=given.state_file,
        )


COMMAND = Command(add_options, run, EPILOG)
