"""Checks of the network: the port, the learner that answers there, its clock, and Zenoh on loopback."""

from __future__ import annotations

import errno
import os
import socket
import statistics
import time
from dataclasses import dataclass

from common.errors import CodecError, SessionError, WireError
from common.printable import printable
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.endpoint import Endpoint, free_port
from common.wire.report import RunReport
from common.wire.session import Session, open_session
from common.wire.status_request import ask, connect
from reskpn.doctor.findings import Finding, size

CONNECT_S = 2.0
FAR_S = 1.0
"""Largest harmless difference of two clocks, in seconds: beyond it, times in the log mislead."""

BULK_BYTES = 22_000_000
"""A rollout of 512 humanoid environments is about this large."""

SLOW_LATENCY_S = 0.02
SLOW_BYTES_PER_S = 50e6
_PROBE = "reskpn/v1/doctor"


@dataclass(frozen=True)
class Answer:
    """A learner's report, and the seconds that its clock is ahead of this machine's, to within `unsure_s`."""

    report: RunReport
    ahead_s: float
    unsure_s: float


def ask_learner(endpoint: str, timeout_s: float = CONNECT_S, credentials: Credentials = NO_CREDENTIALS) -> Answer:
    """Ask the learner at an endpoint for its report and its time; WireError if none answers."""
    with connect(endpoint, timeout_s, credentials) as session:
        ask(
            session, endpoint, timeout_s
        )  # the learner's endpoints are known from here on: the next question takes one round trip
        asked_ns = time.time_ns()
        report = ask(session, endpoint, timeout_s)
        answered_ns = time.time_ns()
    middle_ns = (asked_ns + answered_ns) // 2
    return Answer(report, (report.t_ns - middle_ns) / 1e9, (answered_ns - asked_ns) / 2e9)


def check_port(
    endpoint: str, credentials: Credentials = NO_CREDENTIALS, *, joins: bool = False
) -> tuple[Finding, Answer | None]:
    """Find out whether a learner can listen at an address, or which one does; also returns its answer.

    `joins`: a learner must be there, for an actor to join.

    Raises `SessionError` for what is not an address, and `SettingsError` for credentials that cannot be used there.
    """
    credentials.options([], [endpoint])
    state = port_state(Endpoint.parse(endpoint))
    if state == "free" and joins:
        text = f"nobody listens at {endpoint}, where a learner should be"
        return Finding("port", "problem", text, "start the learner first, or check its address"), None
    if state == "free":
        return Finding("port", "ok", f"{endpoint} is free: no learner runs there, and one can be started"), None
    if state == "unknown":
        return Finding("port", "problem", f"the host of {endpoint} is not known", "check its name"), None
    try:
        answer = ask_learner(endpoint, credentials=credentials)
    except CodecError as error:
        return Finding("port", "problem", f"{endpoint}: {error}"), None
    except WireError as error:
        if state == "taken":
            text = f"{endpoint} is in use by a process that does not answer as a learner of this release"
            return Finding("port", "problem", text, "wait if a learner is starting there, or choose another port"), None
        return Finding("port", "problem" if joins else "warning", printable(str(error), 500)), None
    report = answer.report
    text = f"{endpoint}: the learner of {report.run} answers, with {len(report.actors)} of {report.slots} actors"
    return Finding("port", "ok", printable(text)), answer


def port_state(endpoint: Endpoint) -> str:
    """State of an address: "free" or "taken" on this machine, "elsewhere", or "unknown" if there is no such host."""
    try:
        family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=socket.SOCK_STREAM)[0]
    except OSError:
        return "unknown"
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            return "taken" if error.errno in (errno.EADDRINUSE, errno.EACCES) else "elsewhere"
    return "free"


def check_clock(answer: Answer | None) -> Finding:
    """Compare this machine's clock with the learner's."""
    if answer is None:
        return Finding("clock", "ok", time.strftime("%Y-%m-%d %H:%M:%S %Z; no learner to compare it with"))
    figures = {"ahead_s": answer.ahead_s, "unsure_s": answer.unsure_s}
    side = "ahead of" if answer.ahead_s >= 0 else "behind"
    text = f"the learner's is {abs(answer.ahead_s):.3f} s {side} this one (to within {answer.unsure_s:.3f} s)"
    if abs(answer.ahead_s) > FAR_S + answer.unsure_s:
        return Finding("clock", "warning", text, "set both by NTP: times in the log cannot be compared", figures)
    return Finding("clock", "ok", text, figures=figures)


def check_zenoh(count: int = 20, bulk_bytes: int = BULK_BYTES) -> Finding:
    """Measure small requests and large messages on loopback, in this process."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    limit = bulk_bytes + (1 << 20)
    with open_session(listen=[endpoint], max_message_size=limit) as server:
        server.serve(_PROBE, lambda request: request.reply(b""))
        with open_session(connect=[endpoint], connect_timeout_s=10.0, max_message_size=limit) as client:
            _until_served(client)
            latency_s = statistics.median(_seconds(client, b"") for _ in range(count))
            bulk = os.urandom(bulk_bytes)
            bulk_s = statistics.median(_seconds(client, bulk) for _ in range(3))
    rate = bulk_bytes / bulk_s
    text = f"round trip {1e3 * latency_s:.2f} ms, {size(rate)}/s in messages of {size(bulk_bytes)}"
    figures = {"latency_s": latency_s, "bytes_per_s": rate}
    if latency_s > SLOW_LATENCY_S or rate < SLOW_BYTES_PER_S:
        return Finding("zenoh", "warning", text, "this machine is busy, or has too few cores", figures)
    return Finding("zenoh", "ok", text, figures=figures)


def _until_served(client: Session) -> None:
    """Wait until the other side's endpoint is known, shortly after the connection."""
    deadline = time.monotonic() + 10.0
    while True:
        try:
            client.ask(_PROBE, b"", 10.0)
            return
        except SessionError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)


def _seconds(client: Session, payload: bytes) -> float:
    began_s = time.perf_counter()
    client.ask(_PROBE, payload, 30.0)
    return time.perf_counter() - began_s
