"""`reskpn router`: a Zenoh router with the access control of a learner."""

from __future__ import annotations

import argparse

from common.config.faults import PREFIX
from common.config.sources import load
from common.output import say
from reskpn.commands.command import EXIT_CODES, Command
from reskpn.commands.connection import add_connection, over

EPILOG = f"""\
The learner and all processes that connect to it then need transport.router
({PREFIX}TRANSPORT__ROUTER=true) and the router's address as their endpoint. The
router uses the learner's certificates, which must be made for the router's
address: `reskpn certs --hosts ROUTER`. Who is let in is decided by
transport.actor_names and transport.viewer_names, from --config or the
environment.

{EXIT_CODES}"""


def add_options(parser: argparse.ArgumentParser) -> None:
    add_connection(parser, what="address to listen on")
    parser.add_argument("--config", metavar="FILE", help="YAML file of settings; only its transport section is used")
    parser.add_argument(
        "--insecure", action="store_true", help="allow an address beyond loopback without authentication"
    )


def run(given: argparse.Namespace) -> int:
    """Relay until a signal."""
    from reskpn.supervision.stopping import stopping
    from services.router.service import run_router

    transport = over(load(config=given.config).transport, given)
    if given.insecure:
        transport = transport.model_copy(update={"insecure": True})
    with stopping(supervised=False) as stop:
        return run_router(transport, stop=stop, say=say)


COMMAND = Command(add_options, run, EPILOG)
