"""An actor's side of every conversation with the learner."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from common.config.settings import RunSettings, TransportSettings
from common.config.sources import parse_json
from common.errors import CodecError, RefusedError, SessionError
from common.wire.credentials import Credentials
from common.wire.keys import JOIN, Keys, parse_alive
from common.wire.messages import (
    Environment,
    Evaluation,
    Heartbeat,
    Join,
    JoinReply,
    Orders,
    PushReply,
    Rollout,
    Snapshot,
)
from common.wire.session import Session, open_session

JOIN_TIMEOUT_S = 5.0
RETRY_S = 0.25
BUSY_S = 0.05
INCARNATION_BYTES = 16
"""Whoever knows an incarnation can act for it: it must not be guessed, not even from its beginning, which is shown."""

EXPLAIN_EVERY = 20
"""Questions without an answer after which it is looked into, and said, why."""


class Lost(Exception):
    """The learner does not know this incarnation any more, or is gone: join again."""


@dataclass(frozen=True)
class Membership:
    """What joining gave. `restore`: the slot goes on from environments that the learner keeps."""

    run: str
    slot: int
    generation: int
    incarnation: str
    settings: RunSettings
    restore: bool = False


def connect(transport: TransportSettings, timeout_s: float | None, stop: threading.Event) -> Session:
    """A session with the learner at `transport.endpoint`; to be closed.

    Raises:
        SessionError: none within the time, or `stop` was set first.
        SettingsError: the credentials are no use.
    """
    return open_session(
        connect=[transport.endpoint],
        connect_timeout_s=timeout_s,
        max_message_size=transport.max_message_bytes,
        lease_s=transport.lease_s,
        credentials=Credentials.of(transport),
        router=transport.router,
        give_up=stop.is_set,
    )


def join(
    session: Session,
    *,
    run: str,
    physics: str,
    versions: dict[str, str],
    hardware: dict[str, str],
    stop: threading.Event,
    waiting: Callable[[str], None],
    asked: Callable[[str], None] = lambda state: None,
    role: Literal["actor", "evaluator"] = "actor",
) -> Membership | None:
    """Ask for a slot until there is one; None where `stop` was set first, or the run is over.

    An evaluator gets no slot, and what a membership says of one has no meaning for it.

    Args:
        run: the run to work for, or "" for whichever the learner has.
        waiting: told why there is none yet, each time the reason changes.
        asked: told "alone" or "standing by" after every question that got no slot.

    Raises:
        RefusedError: the learner will never take this actor (another schema or run).
    """
    told, alone, lonely = "", 0, "no learner answers yet"
    while not stop.is_set():
        # A fresh incarnation each time: an answer that got lost must not leave two lives with one name.
        incarnation = secrets.token_hex(INCARNATION_BYTES)
        question = Join(run, role, incarnation, versions, hardware, physics)
        try:
            reply = JoinReply.decode(session.ask(JOIN, question.encode(), JOIN_TIMEOUT_S))
        except SessionError:
            alone += 1
            if alone % EXPLAIN_EVERY == 0:
                lonely = f"no learner answers yet: {session.explain()}"
            state, reason = "alone", lonely
        except CodecError as error:
            raise RefusedError(f"the learner speaks another protocol: {error}") from None
        else:
            if reply.accepted:
                settings = parse_json(reply.settings)
                return Membership(reply.run, reply.slot, reply.generation, incarnation, settings, reply.restore)
            if reply.finished:
                waiting(reply.reason)
                return None
            if reply.final:
                raise RefusedError(f"the learner does not take this actor: {reply.reason}")
            state, reason = "standing by", reply.reason
        asked(state)
        if reason != told:
            waiting(reason)
            told = reason
        stop.wait(RETRY_S)
    return None


class Following:
    """The conversation of one incarnation that follows a run: orders and policies in, something out."""

    def __init__(self, session: Session, run: str, *, push_timeout_s: float) -> None:
        self._session = session
        self._keys = Keys(run)
        self._push_timeout_s = push_timeout_s
        self._changed = threading.Condition()
        self._orders: Orders | None = None
        self._learner_gone = False
        session.subscribe(self._keys.policy_notify, self._on_orders)
        session.watch_alive(self._keys.alive("learner", "learner"), self._on_learner)

    def orders(self, *, newer_than: Orders | None, timeout_s: float) -> Orders | None:
        """The newest orders once they differ from those given, or None after the time.

        Raises:
            Lost: the learner is gone, and not because the run is over.
        """

        def there() -> bool:
            return self._learner_gone or (self._orders is not None and _differ(self._orders, newer_than))

        with self._changed:
            found = self._changed.wait_for(there, timeout_s)
            over = self._orders is not None and self._orders.finished
            if self._learner_gone and not over:
                raise Lost("the learner is gone")
            return self._orders if found else None

    def snapshot(self) -> Snapshot:
        """The newest policy. Lost where the learner does not answer."""
        try:
            return Snapshot.decode(self._session.ask(self._keys.policy_latest, b"", self._push_timeout_s))
        except (SessionError, CodecError) as error:
            raise Lost(f"no policy from the learner: {error}") from None

    def _push(self, key: str, data: bytes, stop: threading.Event) -> bool:
        while not stop.is_set():
            try:
                reply = PushReply.decode(self._session.ask(key, data, self._push_timeout_s))
            except SessionError:
                # It may have arrived: the learner knows a repeat by its number.
                if self._learner_gone:
                    raise Lost("the learner is gone") from None
                stop.wait(RETRY_S)
                continue
            if reply.status == "accepted":
                return True
            if reply.status == "refused":
                return _refused(reply.reason)
            stop.wait(BUSY_S)
        return False

    def _on_orders(self, key: str, data: bytes) -> None:
        try:
            orders = Orders.decode(data)
        except CodecError:
            return  # the learner says them again in half a second
        with self._changed:
            self._orders = orders
            self._changed.notify_all()

    def _on_learner(self, key: str, alive: bool) -> None:
        role, _ = parse_alive(key)
        with self._changed:
            # For good: a learner that comes back has seen this actor go, too, and has given up its slot.
            self._learner_gone |= role == "learner" and not alive
            self._changed.notify_all()


class Link(Following):
    """The conversation of one incarnation of an actor: orders in, rollouts out."""

    def __init__(self, session: Session, member: Membership, *, push_timeout_s: float) -> None:
        super().__init__(session, member.run, push_timeout_s=push_timeout_s)
        self._member = member
        self._beat = session.publisher(self._keys.heartbeat(member.slot), express=True, high_priority=True)
        session.declare_alive(self._keys.alive("actor", member.incarnation))

    def environment(self) -> Environment:
        """The environments that the slot goes on from. Lost where the learner has none for it any more."""
        key = self._keys.environment(self._member.slot)
        try:
            return Environment.decode(self._session.ask(key, b"", self._push_timeout_s))
        except (SessionError, CodecError) as error:
            raise Lost(f"no environments from the learner: {error}") from None

    def push(self, rollout: Rollout, stop: threading.Event) -> bool:
        """Send until there is an answer; whether the learner took it.

        Raises:
            Lost: the learner is gone, or does not know this incarnation any more.
            RefusedError: what was sent is malformed; sending it again would not help.
        """
        return self._push(self._keys.rollout(self._member.slot), rollout.encode(), stop)

    def push_evaluation(self, evaluation: Evaluation, stop: threading.Event) -> bool:
        """As `push`, for an evaluation."""
        return self._push(self._keys.evaluation(self._member.slot), evaluation.encode(), stop)

    def push_environment(self, environment: Environment, stop: threading.Event) -> bool:
        """As `push`, for the state of the slot's environments."""
        return self._push(self._keys.environment(self._member.slot), environment.encode(), stop)

    def beat(self, heartbeat: Heartbeat) -> None:
        self._beat.put(heartbeat.encode())


def _refused(reason: str) -> bool:
    """False where the learner has no use for this any more; raises where something is wrong."""
    slug = reason.split(":")[0]
    if slug in ("stale", "surplus"):
        return False
    if slug in ("incarnation", "gap"):
        raise Lost(reason)
    raise RefusedError(f"the learner refused what this actor sent: {reason}")


def _differ(new: Orders, old: Orders | None) -> bool:
    """Whether two orders ask for different things; when they were said does not count."""
    if old is None:
        return True
    return (new.version, new.digest, new.collect, new.evaluate, new.finished) != (
        old.version,
        old.digest,
        old.collect,
        old.evaluate,
        old.finished,
    )
