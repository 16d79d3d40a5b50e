"""The question how a run is doing, asked of its learner by whoever watches it."""

from __future__ import annotations

import threading
import time

from common.errors import SessionError
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.keys import STATUS
from common.wire.report import MAX_REPORT_BYTES, RunReport
from common.wire.session import Session, open_session

CONNECT_S = 3.0
"""Seconds to connect to a learner, and then for its answer."""

ASK_S = 1.0

_RETRY = threading.Event()  # never set: nothing ends the pause between two questions early


def connect(endpoint: str, timeout_s: float = CONNECT_S, credentials: Credentials = NO_CREDENTIALS) -> Session:
    """A session with the process that listens at `endpoint`; SessionError if there is none within the time."""
    return open_session(
        connect=[endpoint],
        connect_timeout_s=timeout_s,
        max_message_size=MAX_REPORT_BYTES,
        credentials=credentials,
        # Closing waits for a connection that is being made: 10 s with a program that says nothing.
        options={"transport/unicast/open_timeout": round(1000 * timeout_s)},
    )


def ask(session: Session, endpoint: str, timeout_s: float = CONNECT_S) -> RunReport:
    """The report of the learner that the session is connected to.

    Raises:
        SessionError: no learner answers there.
        CodecError: the answer is not a report.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return RunReport.decode(session.ask(STATUS, b"", ASK_S))
        except SessionError:
            # A learner's endpoints become known shortly after the connection, and one that starts declares them later.
            if time.monotonic() >= deadline:
                raise SessionError(
                    f"something listens at {endpoint} but does not answer as a learner: it is still starting, "
                    "stopped or of an older release, another program has the port, or the name in this certificate, "
                    "or this user, may not watch the run (transport.viewer_names there)"
                ) from None
        _RETRY.wait(0.1)
