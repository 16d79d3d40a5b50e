"""Listeners: authentication is required beyond loopback, and refused connections are reported by reason."""

from __future__ import annotations

import abc
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Self, final

from common.errors import SettingsError
from common.printable import printable
from common.wire.access import LEARNER
from common.wire.credentials import Credentials
from common.wire.endpoint import is_loopback
from common.wire.refusals import REASONS, StandardOutputTap, is_zenoh_line, refusal
from common.wire.session import Session, log_refused_connections

if TYPE_CHECKING:
    from common.config.settings import TransportSettings

OnRefused = Callable[[str, str], None]
"""(reason, a sentence on it)."""


def require_authentication(transport: TransportSettings, *, as_options: bool = False) -> None:
    """Raises SettingsError for a listener that other machines reach without authentication.

    `as_options`: the error names options of a command instead of settings of a run.
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


class ListenerMonitor(abc.ABC):
    """Reports refused connections. Entered before the session is opened, left after it is closed.

    Implementations: `OpenListenerMonitor`, `AuthenticatedListenerMonitor`.
    """

    @abc.abstractmethod
    def __enter__(self) -> Self: ...

    @abc.abstractmethod
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    @abc.abstractmethod
    def watch(self, session: Session, on_refused: OnRefused) -> None:
        """Report connections that this session refuses from now on."""


@final
class OpenListenerMonitor(ListenerMonitor):
    """For a listener that refuses no connection: there is nothing to report."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing was acquired."""

    def watch(self, session: Session, on_refused: OnRefused) -> None:
        """Nothing will be reported."""


@final
class AuthenticatedListenerMonitor(ListenerMonitor):
    """Finds refused connections in Zenoh's log lines, and clients without a role by the names in their certificates."""

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
        session.watch_names(self._check_name)

    def _take(self, line: str) -> bool:
        if not is_zenoh_line(line):
            return False
        if (reason := refusal(line)) is not None:
            self._on_refused(reason, REASONS[reason])
        return True

    def _check_name(self, name: str) -> None:
        if name not in self._known:
            self._on_refused("stranger", f"{REASONS['stranger']}: {printable(name, 64)}")


def make_listener_monitor(transport: TransportSettings) -> ListenerMonitor:
    """The monitor of a listener with these settings. A learner at a router does not listen: the router reports."""
    authenticated = Credentials.of(transport).authenticate(transport.endpoint) and not transport.router
    return AuthenticatedListenerMonitor(transport) if authenticated else OpenListenerMonitor()
