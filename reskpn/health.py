"""`python -m reskpn.health learner | router | actor | evaluator`: whether that service on this machine is working.

It runs every few seconds beside the service, so it loads little: no settings, no JAX.
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
from common.wire.credentials import NO_CREDENTIALS, Credentials
from services.worker.state_file import LEARNER_RESUMES, OLD_S, read_state

if TYPE_CHECKING:
    from common.wire.messages import JoinReply
    from common.wire.session import Session

NO_RUN = "health-check"
"""The run that is asked for. No run has this name, and a request for another run leaves no trace at the learner."""

MESSAGE_BYTES = 4 << 20
RETRY_S = 0.05


@dataclass(frozen=True)
class Health:
    """The state of a service, and a sentence that describes it."""

    good: bool
    text: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the state of the service; returns 0 if it is working, 1 if not, 2 for a file that is not an actor's."""
    parser = argparse.ArgumentParser(
        prog="python -m reskpn.health",
        description="Check whether a learner answers requests to join, a router accepts connections with valid "
        "certificates, or an actor or evaluator has a policy.",
        epilog="exit codes: 0 working, 1 not working, 2 an option is not possible",
    )
    services = parser.add_subparsers(dest="service", required=True)
    for name in ("learner", "router"):
        add = services.add_parser(name).add_argument
        add("--endpoint", default="tcp/127.0.0.1:7447", metavar="ADDRESS", help="default: %(default)s")
        add("--timeout", type=float, default=5.0, metavar="S", help="seconds to wait for an answer (%(default)s)")
        add(
            "--certificates",
            type=Path,
            metavar="DIR",
            help="directory with the learner's or an actor's certificate",
        )
        if name == "learner":
            add("--port", type=int, metavar="N", help="ask at its transport.health_port instead")
            add("--ready", action="store_true", help="a learner that resumes a run, and takes nobody yet, will not do")
        add("--users", type=Path, metavar="FILE", help=f"file with a line user:password that the {name} accepts")
    for name in ("actor", "evaluator"):
        follower = services.add_parser(name)
        follower.add_argument(
            "--state-file", type=Path, required=True, metavar="FILE", help="the service's own --state-file"
        )
    given = parser.parse_args(arguments)
    try:
        if given.service == "learner" and given.port is not None:
            health = port_health(given.port, given.timeout, ready=given.ready)
        elif given.service == "learner":
            credentials = Credentials(given.certificates, given.users)
            health = learner_health(given.endpoint, given.timeout, credentials, ready=given.ready)
        elif given.service == "router":
            health = router_health(given.endpoint, given.timeout, Credentials(given.certificates, given.users))
        else:
            health = follower_health(given.service, given.state_file)
    except ReskpnError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(health.text)
    return 0 if health.good else 1


def learner_health(
    endpoint: str, timeout_s: float, credentials: Credentials = NO_CREDENTIALS, *, ready: bool = False
) -> Health:
    """Ask the learner at the endpoint to join, as an actor does, and see whether it answers.

    `ready`: an answer that it takes nobody yet, since it resumes its run, is not good.
    """
    from common.wire.messages import RESUMING
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
    if reply.slug == RESUMING:
        return Health(not ready, f"{reply.text} (run {reply.run})")
    return Health(True, f"the learner answers joins for run {reply.run}")


def port_health(port: int, timeout_s: float, *, ready: bool = False) -> Health:
    """Ask the learner of this machine at its `transport.health_port`, which needs neither certificates nor Zenoh.

    `ready`: as `learner_health`.
    """
    import http.client

    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=timeout_s)
    try:
        connection.request("GET", "/ready" if ready else "/")
        answer = connection.getresponse()
        return Health(answer.status == 200, answer.read(1024).decode("utf-8", "replace").strip())
    except (OSError, http.client.HTTPException) as error:
        return Health(False, f"the learner does not answer at port {port}: {error or type(error).__name__}")
    finally:
        connection.close()


def router_health(endpoint: str, timeout_s: float, credentials: Credentials = NO_CREDENTIALS) -> Health:
    """Connect to the router at the endpoint with these credentials. No learner is needed behind it."""
    from common.wire.session import open_session

    try:
        with open_session(
            connect=[endpoint],
            connect_timeout_s=timeout_s,
            max_message_size=MESSAGE_BYTES,
            credentials=credentials,
            router=True,
        ):
            return Health(True, f"the router at {endpoint} accepts connections")
    except ReskpnError as error:
        return Health(False, f"the router accepts no connection: {error}")


def follower_health(service: str, state_file: Path) -> Health:
    """Read from its state file whether an actor or evaluator has a policy, or stands by for a slot.

    Raises:
        SettingsError: the file is not one that such a service keeps.
    """
    found = read_state(state_file)
    if found is None:
        return Health(False, f"no {service} has written {state_file} yet")
    age_s = time.time() - found.time_s
    if age_s > OLD_S:
        return Health(False, f"the {service} last reported {age_s:.0f} s ago ({found.state})")
    if found.state == "standing by":
        return Health(True, f"the {service} stands by: all slots are taken")
    if found.state == LEARNER_RESUMES:
        return Health(True, f"the {service} waits for its learner, which is resuming its run")
    if found.version < 0:
        return Health(False, f"the {service} has no policy yet ({found.state})")
    return Health(True, f"the {service} has policy {found.version} ({found.state})")


def _ask(session: Session, deadline: float) -> JoinReply:
    """The answer to a join. Repeated, since a peer's endpoints become known shortly after connecting."""
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
