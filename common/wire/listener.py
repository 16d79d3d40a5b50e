"""Who comes in where a process listens: authentication beyond loopback, and a count of those who were refused."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Self

from common.errors import SettingsError
from common.printable import printable
from common.wire.access import LEARNER
from common.wire.credentials import Credentials
from common.wire.endpoint import is_loopback
from common.wire.refusals import REASONS, StandardOutputTap, of_zenoh, refusal
from common.wire.session import Session, log_refused_connections

if TYPE_CHECKING:
    from common.config.settings import TransportSettings

OnRefused = Callable[[str, str], None]
"""(reason, a sentence on it)."""


def require_authentication(transport: TransportSettings, *, as_options: bool = False) -> None:
    """SettingsError where other machines reach a listener that does not ask who they are.

    `as_options`: it was given by options of a command, and not as settings of a run.
    """
    known = Credentials.of(transport).authenticate(transport.endpoint)
    if known or is_loopback(transport.endpoint) or transport.insecure:
        return
    name, yes = ("--", "") if as_options else ("--transport.", " true")
    raise SettingsError(
        f"{name}endpoint {transport.endpoint} can be reached from other machines and has no authentication; listen on "
        f"tcp/127.0.0.1:<port>, or on tls/<host>:<port> with {name}certificates (`reskpn certs` makes them), or give "
        f"{name}users, or say {name}insecure{yes} if the network is trusted"
    )


class ListenerMonitor:
    """For a listener that refuses nobody."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def watch(self, session: Session, on_refused: OnRefused) -> None:
        """Tell from now on who was refused at this session."""


class AuthenticatedListenerMonitor(ListenerMonitor):
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


def make_listener_monitor(transport: TransportSettings) -> ListenerMonitor:
    """Guarded where the listener asks who comes in. A learner at a router does not listen: the router's door counts."""
    guarded = Credentials.of(transport).authenticate(transport.endpoint) and not transport.router
    return AuthenticatedListenerMonitor(transport) if guarded else ListenerMonitor()
