"""Both sides of the hub's conversations, for its tests: a learner with a real log, and an actor in plain words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from queue import Queue
from typing import Any

from samples import RUN, question, settings, snapshot

from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.wire.keys import JOIN, Keys
from common.wire.messages import JoinReply, PushReply
from common.wire.rollout import Rollout
from common.wire.session import Session
from services.learner.endpoints.hub import Hub

DEADLINE_S = 15.0
KEYS = Keys(RUN)


class HeldLog:
    """A log that writes what is to be acknowledged when it is told to, as a slow disk would."""

    def __init__(self, log: LogWriter) -> None:
        self._log = log
        self._held: Queue[tuple[str, Any, Callable[[], None]]] = Queue()
        self._free = True

    def hold(self) -> None:
        self._free = False

    def let_one_go(self) -> None:
        """Write the message that has waited longest, once there is one."""
        topic, data, on_durable = self._held.get(timeout=DEADLINE_S)
        self._log.write(topic, data, on_durable=on_durable)

    @property
    def pending_bytes(self) -> int:
        return self._log.pending_bytes

    @property
    def waiting(self) -> int:
        return self._held.qsize()

    def write(self, topic: str, data: Any, *, on_durable: Callable[[], None] | None = None) -> None:
        if self._free or on_durable is None:
            self._log.write(topic, data, on_durable=on_durable)
        else:
            self._held.put((topic, data, on_durable))


class Learner:
    """A hub at version 0 on a session of its own, and what it wrote and told."""

    def __init__(
        self,
        session: Session,
        directory: Path,
        starts: Any = (),
        logged_environments: Any = (),
        logged_records: Any = None,
        **changes: Any,
    ) -> None:
        self.settings = settings(**changes)
        self.directory = directory
        self.writer = LogWriter(directory)
        self.log = HeldLog(self.writer)
        self.events: Queue[tuple[str, str, str]] = Queue()
        self.session = session
        log: Any = self.log
        self.hub = Hub(
            RUN,
            self.settings,
            session,
            log,
            lambda *event: self.events.put(event),
            starts=starts,
            logged_environments=logged_environments,
            logged_records=logged_records,
        )
        self.hub.publish(snapshot(0))
        self.hub.open()

    def logged(self) -> list[bytes]:
        """The rollouts that are in the log's files now."""
        return [message.data for message in LogReader(self.directory).messages({"/rollout"})]


class Actor:
    """Asks as an actor does, in the words of the wire."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def ask(self, key: str, payload: bytes) -> bytes:
        return self.session.ask(key, payload, DEADLINE_S)

    def join(self, incarnation: str = "a", **changes: Any) -> JoinReply:
        return JoinReply.decode(self.ask(JOIN, question(incarnation, **changes).encode()))

    def push(self, made: Rollout) -> PushReply:
        return self.push_bytes(made.encode(), made.slot)

    def push_bytes(self, data: bytes, slot: int = 0) -> PushReply:
        return PushReply.decode(self.ask(KEYS.rollout(slot), data))
