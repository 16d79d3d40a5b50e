"""`python -m reskpn.health learner | router | actor | evaluator`: whether that service of this machine does its work.

Run every few seconds beside the service, so it is no part of `reskpn`, whose settings alone take a second to load.
"""

from __future__ import annotations

import argparse
import secrets
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from common.errors import ReskpnError, SessionError
from common.wire.credentials import NOBODY, Credentials
from services.worker.state_file import OLD_S, read_state

if TYPE_CHECKING:
    from common.wire.messages import JoinReply
    from common.wire.session import Session

NO_RUN = "health-check"
"""The run that is asked for: none is called so, and a question for another run leaves no trace at the learner."""

MESSAGE_BYTES = 4 << 20
RETRY_S = 0.05


@dataclass(frozen=True)
class Health:
    """Whether all is well, and a sentence on it."""

    good: bool
    text: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Print how the service is; returns 0 where it does its work, 1 where not, 2 for a file that is not an actor's."""
    parser = argparse.ArgumentParser(
        prog="python -m reskpn.health",
        description="Say whether a learner answers those who want to join, a router lets in those who have their "
        "certificates, or an actor or evaluator has a policy.",
        epilog="exit codes: 0 it is so, 1 it is not, 2 what was given is not possible",
    )
    services = parser.add_subparsers(dest="service", required=True)
    for name in ("learner", "router"):
        add = services.add_parser(name).add_argument
        add("--endpoint", default="tcp/127.0.0.1:7447", metavar="ADDRESS", help="default: %(default)s")
        add("--timeout", type=float, default=5.0, metavar="S", help="how long to wait (%(default)s)")
        add("--certificates", type=Path, metavar="DIR", help="those of the learner, or of an actor")
        add("--users", type=Path, metavar="FILE", help=f"with a user:password that the {name} lets in")
    for name in ("actor", "evaluator"):
        follower = services.add_parser(name)
        follower.add_argument("--state-file", type=Path, required=True, metavar="FILE", help="as it was given to it")
    given = parser.parse_args(arguments)
    try:
        if given.service in ("learner", "router"):
            examine = learner_health if given.service == "learner" else router_health
            health = examine(given.endpoint, given.timeout, Credentials(given.certificates, given.users))
        else:
            health = follower_health(given.service, given.state_file)
    except ReskpnError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(health.text)
    return 0 if health.good else 1


def learner_health(endpoint: str, timeout_s: float, credentials: Credentials = NOBODY) -> Health:
    """Whether the learner at the endpoint answers those who want to join, asked as an actor asks."""
    from common.wire.session import open_session

    deadline = time.monotonic() + timeout_s
    try:
        with open_session(
            connect=[endpoint],
            connect_timeout_s=timeout_s,
            max_message_size=MESSAGE_BYTES,
            credentials=credentials,
        ) as session:
            reply = _ask(session, deadline)
    except ReskpnError as error:
        return Health(False, f"the learner takes no joins: {error}")
    return Health(True, f"the learner answers joins for run {reply.run}")


def router_health(endpoint: str, timeout_s: float, credentials: Credentials = NOBODY) -> Health:
    """Whether the router at the endpoint lets in who has these credentials. There need be no learner behind it."""
    from common.wire.session import open_session

    try:
        with open_session(
            connect=[endpoint],
            connect_timeout_s=timeout_s,
            max_message_size=MESSAGE_BYTES,
            credentials=credentials,
            router=True,
        ):
            return Health(True, f"the router at {endpoint} lets in who has credentials")
    except ReskpnError as error:
        return Health(False, f"the router lets nobody in: {error}")


def follower_health(service: str, state_file: Path) -> Health:
    """Whether the actor or evaluator that keeps this file has a policy, or stands by for a slot.

    Raises:
        SettingsError: the file is not one that such a service keeps.
    """
    found = read_state(state_file)
    if found is None:
        return Health(False, f"no {service} has written {state_file} yet")
    age_s = time.time() - found.time_s
    if age_s > OLD_S:
        return Health(False, f"the {service} gave its last sign of life {age_s:.0f} s ago ({found.state})")
    if found.state == "standing by":
        return Health(True, f"the {service} stands by: all slots are taken")
    if found.version < 0:
        return Health(False, f"the {service} has no policy yet ({found.state})")
    return Health(True, f"the {service} has policy {found.version} ({found.state})")


def _ask(session: Session, deadline: float) -> JoinReply:
    """The answer to a join. Asked again while nobody serves it: what a peer serves is known shortly after it is."""
    from common.wire.keys import JOIN
    from common.wire.messages import Join, JoinReply

    question = Join(NO_RUN, "actor", secrets.token_hex(8), {}, {}, "native").encode()
    while True:
        try:
            return JoinReply.decode(session.ask(JOIN, question, max(RETRY_S, deadline - time.monotonic())))
        except SessionError:
            if time.monotonic() + RETRY_S > deadline:
                raise
            time.sleep(RETRY_S)


if __name__ == "__main__":
    sys.exit(main())
