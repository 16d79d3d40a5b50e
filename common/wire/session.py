"""The transport: requests, publications and liveliness over Zenoh, which is imported nowhere else.

Peers talk directly: a learner listens, the others connect to it and need nothing but its address. There is no discovery
on the network, and a lost connection is re-established for ever, with all that was declared on it.

Handlers run on threads of Zenoh, one for each declaration, and must not block. What they raise goes to `on_error`.
Replies leave from threads of their own.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from types import TracebackType
from typing import Any, Self

import zenoh

from common.errors import SessionError
from common.wire.connections import explain, wait_connected
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.diagnosis import cannot_open, no_connection, plain
from common.wire.handlers import OnError, Request, check_size, guarded, log_error
from common.wire.reply_sender import ReplySender
from common.wire.zenoh_settings import CLIENT, ZENOH_LOG, zenoh_settings


class Publisher:
    """Puts on one key. What does not fit into a slow subscriber's queue is dropped, so publish what a later put renews.

    A `patient` publisher waits instead.
    """

    def __init__(self, key: str, publisher: zenoh.Publisher, check_size: Callable[[str, bytes], None]) -> None:
        self._key = key
        self._publisher = publisher
        self._check_size = check_size

    def put(self, data: bytes) -> None:
        """Raises `SessionError` when the session is closed or the message is larger than agreed."""
        self._check_size(self._key, data)
        try:
            self._publisher.put(data)
        except zenoh.ZError as error:
            raise SessionError(f"cannot publish on {self._key}: {plain(error)}") from error


class Session:
    """An open session; made by `open_session`.

    Use it as a context manager: the threads of a session that is not closed keep the process from ending.
    """

    def __init__(
        self, session: zenoh.Session, max_message_size: int, on_error: OnError, explain: Callable[[], str]
    ) -> None:
        self._session = session
        self._max_message_size = max_message_size
        self._on_error = on_error
        self._explain = explain
        self._lock = threading.Lock()
        # What was declared with a callback lives until it is undeclared or the session closes, referred to or not.
        self._held: list[Any] = []
        self._senders: list[ReplySender] = []
        self._queriers: dict[tuple[str, float], zenoh.Querier] = {}

    def serve(self, key: str, handler: Callable[[Request], None]) -> None:
        """Answer the queries on `key`, which may hold wildcards. A reply never blocks the thread that gives it."""
        sender = ReplySender(key)
        with self._lock:
            self._senders.append(sender)

        def on_query(query: zenoh.Query) -> None:
            payload = query.payload
            key = str(query.key_expr)

            def send(data: bytes) -> None:
                try:
                    with query:  # ends the asker's wait now, not when this object is collected
                        query.reply(key, data)
                except zenoh.ZError as error:
                    if not self._session.is_closed():
                        self._on_error(key, SessionError(f"cannot answer on {key}: {plain(error)}"))

            def answer(data: bytes) -> None:
                self._check_size(key, data)
                if not sender.submit(partial(send, data)):
                    query.drop()

            try:
                handler(Request(key, b"" if payload is None else payload.to_bytes(), answer))
            except Exception as error:
                self._on_error(key, error)
                query.drop()  # a traceback that is kept would keep the asker waiting

        self._hold(lambda: self._session.declare_queryable(key, self._guarded(key, on_query)))

    def ask(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        """The first answer to `payload` on `key`.

        Blocks the caller, not a thread of Zenoh; while the other side does not read, for up to 30 s beyond
        `timeout_s`. Raises `SessionError` at once when nobody serves `key` or the answerer goes away, and after
        `timeout_s` when it does not answer. The request may have arrived all the same.
        """
        self._check_size(key, payload)
        try:
            reply = self._querier(key, timeout_s).get(payload=payload).recv()
        except zenoh.ZError as error:
            why = "this session is closed" if self._session.is_closed() else "nobody connected serves it, or left"
            raise SessionError(f"no answer on {key}: {why}") from error
        if reply.ok is None:
            raise SessionError(
                f"no answer on {key} within {timeout_s:g} s: the other side is busy or stopped, or refuses messages "
                f"as large as {len(payload):,} bytes"
            )
        return reply.ok.payload.to_bytes()

    def publisher(
        self, key: str, *, express: bool = False, high_priority: bool = False, patient: bool = False
    ) -> Publisher:
        """`express` messages do not wait to be batched; `high_priority` ones overtake bulk data.

        `patient`: `put` waits for slow subscribers, until one is given up that has stalled for 30 s.
        """
        priority = zenoh.Priority.INTERACTIVE_HIGH if high_priority else zenoh.Priority.DATA
        congestion = zenoh.CongestionControl.BLOCK if patient else zenoh.CongestionControl.DROP
        publisher = self._hold(
            lambda: self._session.declare_publisher(
                key, congestion_control=congestion, priority=priority, express=express
            )
        )
        return Publisher(key, publisher, self._check_size)

    def subscribe(self, key: str, handler: Callable[[str, bytes], None]) -> None:
        """Call `handler(key, data)` for what is put on `key`, which may hold wildcards."""

        def on_sample(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.payload.to_bytes())

        self._hold(lambda: self._session.declare_subscriber(key, self._guarded(key, on_sample)))

    def declare_alive(self, key: str) -> None:
        """Show `key` as alive until this session closes, its process dies or its machine is silent for a lease."""
        self._hold(lambda: self._session.liveliness().declare_token(key))

    def watch_alive(self, key: str, handler: Callable[[str, bool], None]) -> None:
        """Call `handler(key, alive)` for each token on `key` that is there, appears or goes."""

        def on_token(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._hold(
            lambda: self._session.liveliness().declare_subscriber(key, self._guarded(key, on_token), history=True)
        )

    def watch_names(self, handler: Callable[[str], None]) -> None:
        """Call `handler(name)` with the name in the certificate of every peer that connects with one."""

        def on_link(event: zenoh.LinkEvent) -> None:
            name = event.link.auth_identifier
            if name is not None and event.kind == zenoh.SampleKind.PUT:
                handler(name)

        self._hold(lambda: self._session.info.declare_link_events_listener(self._guarded("names", on_link)))

    def explain(self) -> str:
        """The reason why nothing answers, as far as can be found within seconds; empty for a session that listens."""
        return self._explain()

    def close(self) -> None:
        """Undeclare all that was declared, and close; may be called repeatedly, and from a handler."""
        with self._lock:
            declared = [*self._queriers.values(), *reversed(self._held)]
            senders = list(self._senders)
            self._held.clear()
            self._queriers.clear()
            self._senders.clear()
        for sender in senders:
            sender.close()
        for one in declared:
            with suppress(zenoh.ZError):  # the session may be closed already
                one.undeclare()
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _querier(self, key: str, timeout_s: float) -> zenoh.Querier:
        # A declared querier is faster than asking the session, and its key is sent as a number.
        with self._lock:
            if (key, timeout_s) not in self._queriers:
                self._queriers[key, timeout_s] = self._session.declare_querier(
                    key,
                    timeout=timeout_s,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    consolidation=zenoh.ConsolidationMode.NONE,
                )
            return self._queriers[key, timeout_s]

    def _hold(self, declare: Callable[[], Any]) -> Any:
        try:
            declared = declare()
        except zenoh.ZError as error:
            raise SessionError(f"cannot use this session: {plain(error)}") from error
        with self._lock:
            self._held.append(declared)
        return declared

    def _guarded(self, key: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        return guarded(key, callback, self._on_error)

    def _check_size(self, key: str, data: bytes) -> None:
        check_size(key, data, self._max_message_size)


def open_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    connect_timeout_s: float | None = None,
    max_message_size: int,
    lease_s: float = 2.0,
    credentials: Credentials = NO_CREDENTIALS,
    options: Mapping[str, object] | None = None,
    on_error: OnError = log_error,
    router: bool = False,
    give_up: Callable[[], bool] = lambda: False,
) -> Session:
    """Open a session that listens on, or connects to, endpoints such as `tcp/127.0.0.1:7447`.

    `connect_timeout_s=None` returns at once and goes on trying to connect for ever; until then `ask` finds nobody.
    `max_message_size` is in bytes, of one message. A peer that is silent for `lease_s` counts as gone. `credentials`
    identify this process, and those that it lets in. `options` are further settings of Zenoh by path. `router`: the
    address is that of a router, which is waited for, for ever too, unless `give_up()`; with a timeout a router is
    recognised without this.

    Raises `SessionError`: not an address, an address that cannot be listened on, no connection within the time; and
    `SettingsError` where the credentials cannot be used.
    """
    known = credentials.options(listen, connect)
    settings = {**zenoh_settings(listen, connect, max_message_size, lease_s), **known, **(options or {})}
    wait_s = connect_timeout_s
    if not router:
        session = _open(settings, listen)
        if connect and wait_s is not None:
            wait_connected(session, connect, wait_s, credentials)
            router = bool(session.info.routers_zid())
            if router:  # a router passes nothing on between peers
                session.close()
    if router:
        session = _open_client(settings, connect, wait_s, credentials, give_up)
    return Session(session, max_message_size, on_error, partial(explain, session, tuple(connect), credentials))


def _open(settings: Mapping[str, object], listen: Sequence[str]) -> zenoh.Session:
    config = zenoh.Config()
    for path, value in settings.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise SessionError(f"Zenoh has no setting {path} = {value!r}: {plain(error)}") from error
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise SessionError(cannot_open(listen, plain(error))) from error


def _open_client(
    settings: dict[str, object],
    connect: Sequence[str],
    timeout_s: float | None,
    credentials: Credentials,
    give_up: Callable[[], bool],
) -> zenoh.Session:
    """Open a client of a router. Zenoh cannot be interrupted while it connects one, so each attempt is short."""
    deadline = None if timeout_s is None else time.monotonic() + timeout_s
    while True:
        try:
            return _open(settings | CLIENT, ())
        except SessionError:
            if deadline is not None and time.monotonic() >= deadline:
                raise SessionError(no_connection(connect, timeout_s or 0.0, credentials)) from None
            if give_up():
                raise SessionError(f"stopped before there was a connection to {', '.join(connect)}") from None


def log_refused_connections() -> None:
    """From now on write a line for each refused connection to standard output, for `common.wire.refusals`."""
    zenoh.init_log_from_env_or(ZENOH_LOG)
