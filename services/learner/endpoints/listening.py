"""The session that a learner is reached by."""

from __future__ import annotations

from common.config.settings import TransportSettings
from common.errors import SettingsError
from common.wire.access import LEARNER, Names, access_control
from common.wire.credentials import Credentials, read_users
from common.wire.session import Session, open_session

ROUTER_S = 60.0
"""How long a learner waits for its router."""


def open_listener(transport: TransportSettings) -> Session:
    """Open the learner's session. A name in its settings may do what its role may; without credentials, everyone may.

    Raises `SessionError` and `SettingsError` as `open_session`.
    """
    if transport.router:
        return _open_at_router(transport)
    access = {}
    if Credentials.of(transport).authenticate(transport.endpoint):
        names = Names(transport.actor_names, transport.viewer_names)
        access = access_control(names, by_password=transport.users is not None)
    return open_session(
        listen=[transport.endpoint],
        max_message_size=transport.max_message_bytes,
        lease_s=transport.lease_s,
        credentials=Credentials.of(transport),
        options=access,
    )


def _open_at_router(transport: TransportSettings) -> Session:
    """Open a session with a router, which has the access control.

    Raises SettingsError where the first user, as which it connects, is not the learner: nothing would reach it.
    """
    if transport.users is not None and (user := next(iter(read_users(transport.users)))) != LEARNER:
        raise SettingsError(
            f"at a router the learner is a user itself, the first in its file: {transport.users} begins with {user!r}; "
            f"give it a file that begins with {LEARNER}:password, the same password as in the router's file"
        )
    return open_session(
        connect=[transport.endpoint],
        connect_timeout_s=ROUTER_S,
        max_message_size=transport.max_message_bytes,
        lease_s=transport.lease_s,
        credentials=Credentials.of(transport),
        router=True,
    )
