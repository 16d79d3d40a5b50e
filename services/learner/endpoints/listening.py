"""The learner's session, at which the others meet it."""

from __future__ import annotations

from common.config.settings import TransportSettings
from common.errors import SettingsError
from common.wire.access import LEARNER, Names, access_control
from common.wire.credentials import Credentials, read_users
from common.wire.session import Session, open_session

ROUTER_S = 60.0
"""How long a learner waits for its router."""


def open_listener(transport: TransportSettings) -> Session:
    """The learner's session. Who has a name in its settings may do what his role may; without credentials, everyone.

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
    """A session with a router, which knows who may do what.

    Raises SettingsError where the first user, as whom it connects, is not the learner: nobody would get through to it.
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
