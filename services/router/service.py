"""The router as a process: Zenoh's own, with a learner's access control and a count of refused connections."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

from common.config.settings import TransportSettings
from common.errors import SettingsError
from common.wire.access import LEARNER, Names, router_access_control
from common.wire.credentials import Credentials, read_users
from common.wire.listener import make_listener_monitor, require_authentication
from common.wire.session import open_session

REPEATED = 100
"""Refused connections of one reason are reported once, and then each time so many have come."""


def run_router(transport: TransportSettings, *, stop: threading.Event, say: Callable[[str], None]) -> int:
    """Pass messages on until `stop` is set. Returns 0.

    Args:
        transport: the endpoint to listen on; the certificates to show (a learner's, made for the router's address), or
            the users; and the names to let in. Without credentials every client may do everything.
        say: gets a line for a person: the endpoint, refused connections.

    Raises:
        SettingsError: credentials that cannot be used, or none where other machines reach it; users without a learner.
        SessionError: an address that cannot be listened on.
    """
    here = transport.model_copy(update={"router": False})
    require_authentication(here, as_options=True)
    credentials = Credentials.of(here)
    access = {}
    if credentials.authenticate(here.endpoint):
        names = Names(here.actor_names, here.viewer_names)
        access = router_access_control(names, by_password=here.users is not None)
    if here.users is not None and LEARNER not in read_users(here.users):
        raise SettingsError(
            f"the router's file of users {here.users} has no {LEARNER}: nobody could serve the others; add a line "
            f"{LEARNER}:password, and let the learner's own file begin with it"
        )
    refused: Counter[str] = Counter()
    lock = threading.Lock()

    def on_refused(reason: str, text: str) -> None:
        with lock:  # the lines and the events of Zenoh come on threads of their own
            refused[reason] += 1
            count = refused[reason]
        if count % REPEATED == 1:
            say(f"refused ({count:,} times so far): {text}")

    with (
        make_listener_monitor(here) as listener,
        open_session(
            listen=[here.endpoint],
            max_message_size=here.max_message_bytes,
            lease_s=here.lease_s,
            credentials=credentials,
            options={"mode": "router", **access},
        ) as session,
    ):
        listener.watch(session, on_refused)
        clients = f"lets in {', '.join(['learner', *here.actor_names, *here.viewer_names])}"
        say(f"router: listening on {here.endpoint}; {clients if access else 'no authentication'}")
        stop.wait()
    counts = ", ".join(f"{reason} {count:,}" for reason, count in sorted(refused.items()))
    say(f"router: stopped; refused connections: {counts or 'none'}")
    return 0
