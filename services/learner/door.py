"""Who comes in: the learner's session with its access control, and a count of those who were refused."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from common.printable import printable
from common.settings import TransportSettings
from common.wire.access import LEARNER, Names, access_control
from common.wire.credentials import Credentials
from common.wire.refusals import REASONS, StandardOutputTap, of_zenoh, refusal
from common.wire.session import Session, log_refused_connections, open_session

ROUTER_S = 60.0
"""How long a learner waits for its router."""

OnRefused = Callable[[str, str], None]
"""(reason, a sentence on it)."""


def open_to_actors(transport: TransportSettings) -> Session:
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
    """A session with a router, which knows who may do what."""
    return open_session(
        connect=[transport.endpoint],
        connect_timeout_s=ROUTER_S,
        max_message_size=transport.max_message_bytes,
        lease_s=transport.lease_s,
        credentials=Credentials.of(transport),
        router=True,
    )


class OpenDoor:
    """For a learner that refuses nobody."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def watch(self, session: Session, on_refused: OnRefused) -> None:
        """Tell from now on who was refused at this session."""


class GuardedDoor(OpenDoor):
    """Counts who was refused. Entered before the session is opened, left after it is closed."""

    def __init__(self, transport: TransportSettings) -> None:
        self._known = {*transport.actor_names, *transport.viewer_names, LEARNER}
        self._on_refused: OnRefused = lambda reason, text: None
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stack.enter_context(StandardOutputTap(self._take))
        log_refused_connections()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def watch(self, session: Session, on_refused: OnRefused) -> None:
        self._on_refused = on_refused
        session.watch_names(self._greet)

    def _take(self, line: str) -> bool:
        if not of_zenoh(line):
            return False
        if (reason := refusal(line)) is not None:
            self._on_refused(reason, REASONS[reason])
        return True

    def _greet(self, name: str) -> None:
        if name not in self._known:
            self._on_refused("stranger", f"{REASONS['stranger']}: {printable(name, 64)}")


def make_door(transport: TransportSettings) -> OpenDoor:
    """Guarded where the learner asks who comes in."""
    guarded = Credentials.of(transport).authenticate(transport.endpoint) and not transport.router
    return GuardedDoor(transport) if guarded else OpenDoor()
