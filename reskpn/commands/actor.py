"""`reskpn actor`: the process that collects experience."""

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
    add_worker_options(parser, "work for", "actor")


def run(given: argparse.Namespace) -> int:
    """Collect until the run is over, or until a signal."""
    base = load(config=given.config)
    physics = given.physics or base.physics
    # JAX looks at the environment when it is imported, so the service is imported after this.
    adopt(worker_environment(os.environ, physics, base.device_memory.actor))

    from reskpn.supervision.stopping import stopping
    from services.actor.service import run_actor

    allow_task(given, base)
    transport = over(base.transport, given)
    with stopping(supervised=given.supervised) as stop:
        return run_actor(
            transport,
            physics=physics,
            run=given.run,
            threads=given.threads,
            connect_timeout_s=given.connect_timeout,
            rejoin_timeout_s=given.rejoin_timeout,
            stop=stop,
            say=say,
            state_file=given.state_file,
        )


COMMAND = Command(add_options, run, EPILOG)
