"""Connections of an open session: waits for one, and explains why there is none."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from common.errors import SessionError
from common.wire.credentials import Credentials
from common.wire.diagnosis import no_connection, unserved, why_no_connection

_POLL_S = 0.01


def wait_connected(session: Any, connect: Sequence[str], timeout_s: float, credentials: Credentials) -> None:
    """Wait for the first connection of a Zenoh session. SessionError, and the session closed, where none comes."""
    deadline = time.monotonic() + timeout_s
    try:
        while not is_connected(session):
            if time.monotonic() >= deadline:
                raise SessionError(no_connection(connect, timeout_s, credentials))
            time.sleep(_POLL_S)
    except BaseException:
        session.close()
        raise


def is_connected(session: Any) -> bool:
    """True if a Zenoh session has a connection to a peer or a router."""
    return bool(session.info.peers_zid() or session.info.routers_zid())


def explain(session: Any, connect: Sequence[str], credentials: Credentials) -> str:
    """As `Session.explain`, for a Zenoh session."""
    if not connect or session.is_closed():
        return ""
    return unserved(connect[0]) if is_connected(session) else why_no_connection(connect[0], credentials)
