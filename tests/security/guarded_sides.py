"""Both sides of a guarded door: a learner with a real log and hub, and whoever knocks, in the words of the wire."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from queue import Queue
from types import TracebackType
from typing import Any, Self

from samples import RUN, question, settings, snapshot

from common.config.settings import TransportSettings
from common.errors import SessionError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.keys import JOIN, STATUS, Keys
from common.wire.listener import make_listener_monitor
from common.wire.messages import JoinReply, PushReply
from common.wire.report import RunReport
from common.wire.rollout import Rollout
from common.wire.session import open_session
from services.learner.endpoints.hub import Hub
from services.learner.endpoints.listening import open_listener

DEADLINE_S = 15.0
REFUSED_S = 0.6
"""How long an attempt at connecting is made that must fail."""

KEYS = Keys(RUN)
MAX_MESSAGE = 1 << 20
_PAUSE = threading.Event()


def until(condition: Callable[[], bool]) -> None:
    """Waits for what other threads bring about; fails after a deadline."""
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, "what was waited for did not happen in time"
        _PAUSE.wait(0.005)


class GuardedLearner:
    """A hub at version 0 behind its door, and what it told."""

    def __init__(self, transport: TransportSettings, directory: Path) -> None:
        self.transport = transport
        self.directory = directory
        self.events: Queue[tuple[str, str, str]] = Queue()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        transport = self.transport.model_copy(update={"max_message_bytes": MAX_MESSAGE})
        door = self._stack.enter_context(make_listener_monitor(transport))
        self.session = self._stack.enter_context(open_listener(transport))
        log = LogWriter(self.directory)
        self._stack.callback(log.close)
        # Nothing is answered any more when the log is closed.
        self._stack.callback(self.session.close)
        self.hub = Hub(RUN, settings(transport=transport), self.session, log, lambda *event: self.events.put(event))
        door.watch(self.session, self.hub.connection_refused)
        self.hub.publish(snapshot(0))
        self.hub.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def counted(self) -> dict[str, int]:
        """Refused connections by reason."""
        return self.hub.report().refusals.get("connection", {})

    def logged(self) -> int:
        """Rollouts in the log's files."""
        return sum(1 for _ in LogReader(self.directory).messages({"/rollout"}))


class Outside:
    """A session that has connected to a learner; SessionError from its making where it is not let in."""

    def __init__(
        self,
        endpoint: str,
        credentials: Credentials = NO_CREDENTIALS,
        options: dict[str, object] | None = None,
        connect_timeout_s: float = DEADLINE_S,
    ) -> None:
        self.endpoint = endpoint
        self.session = open_session(
            connect=[endpoint],
            connect_timeout_s=connect_timeout_s,
            max_message_size=MAX_MESSAGE,
            credentials=credentials,
            options=options,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.session.close()

    def ask(self, key: str, payload: bytes = b"") -> bytes:
        """The answer, once the other side is known to serve the key."""
        answers: list[bytes] = []

        def answered() -> bool:
            try:
                answers.append(self.session.ask(key, payload, DEADLINE_S))
            except SessionError:
                return False
            return True

        until(answered)
        return answers[0]

    def report(self) -> RunReport:
        """Asked after all that was sent before: it has arrived, or was turned away, when this is answered."""
        return RunReport.decode(self.ask(STATUS))

    def join(self, incarnation: str, **changes: Any) -> JoinReply:
        return JoinReply.decode(self.ask(JOIN, question(incarnation, **changes).encode()))

    def push(self, made: Rollout) -> PushReply:
        return PushReply.decode(self.ask(KEYS.rollout(made.slot), made.encode()))
