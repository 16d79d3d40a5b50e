"""The connection of one worker incarnation to its learner: orders and policies in, results out."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod

from common.errors import CodecError, RefusedError, SessionError
from common.wire.keys import Keys, parse_alive
from common.wire.messages import Orders, PushReply, Snapshot
from common.wire.session import Session
from services.worker.joining import RETRY_S, Assignment, Role

BUSY_S = 0.05


class AssignmentLost(Exception):
    """The learner is gone or no longer knows this incarnation: the worker has to join again."""


class WorkerLink(ABC):
    """Everything that actors and evaluators have in common in talking to a learner.

    A subclass names its role and adds the messages that this role sends.
    """

    def __init__(self, session: Session, assignment: Assignment, *, push_timeout_s: float) -> None:
        self._session = session
        self._keys = Keys(assignment.run)
        self._push_timeout_s = push_timeout_s
        self._changed = threading.Condition()
        self._orders: Orders | None = None
        self._learner_gone = False
        session.subscribe(self._keys.policy_notify, self._on_orders)
        session.watch_alive(self._keys.alive("learner", "learner"), self._on_learner)
        # Last, so that orders sent in response to this declaration already find their subscriber.
        session.declare_alive(self._keys.alive(self.role, assignment.incarnation))

    @property
    @abstractmethod
    def role(self) -> Role:
        """The role under which this worker joined."""

    @property
    def newest(self) -> int | None:
        """The newest policy version announced so far, or None before the first announcement."""
        with self._changed:
            return None if self._orders is None else self._orders.version

    @property
    def over(self) -> bool:
        """True once the learner has announced the end of the run."""
        with self._changed:
            return self._orders is not None and self._orders.finished

    def orders(self, *, newer_than: Orders | None, timeout_s: float) -> Orders | None:
        """Wait for orders that differ from those given; None if none came within the time.

        Raises:
            AssignmentLost: the learner is gone, and the run is not over.
        """

        def there() -> bool:
            return self._learner_gone or (self._orders is not None and _differ(self._orders, newer_than))

        with self._changed:
            found = self._changed.wait_for(there, timeout_s)
            over = self._orders is not None and self._orders.finished
            if self._learner_gone and not over:
                raise AssignmentLost("the learner is gone")
            return self._orders if found else None

    def snapshot(self) -> Snapshot:
        """The newest policy. Raises AssignmentLost if the learner does not answer."""
        try:
            return Snapshot.decode(self._session.ask(self._keys.policy_latest, b"", self._push_timeout_s))
        except (SessionError, CodecError) as error:
            raise AssignmentLost(f"no policy from the learner: {error}") from None

    def _push(self, key: str, data: bytes, stop: threading.Event) -> bool:
        """Send until the learner answers; True if it accepted, False if it has no use for the message or on `stop`.

        Raises:
            AssignmentLost: the learner is gone or no longer knows this incarnation.
            RefusedError: the message is malformed, so that sending it again would not help.
        """
        while not stop.is_set():
            try:
                reply = PushReply.decode(self._session.ask(key, data, self._push_timeout_s))
            except SessionError:
                # The message may have arrived all the same; the learner recognises a duplicate by its number.
                if self._learner_gone:
                    raise AssignmentLost("the learner is gone") from None
                stop.wait(RETRY_S)
                continue
            if reply.status == "accepted":
                return True
            if reply.status == "refused":
                return self._refused(reply)
            stop.wait(BUSY_S)
        return False

    def _refused(self, reply: PushReply) -> bool:
        """False for a message that came too late; raises for every other refusal."""
        if reply.slug in ("stale", "surplus"):
            return False
        if reply.slug in ("incarnation", "gap"):
            raise AssignmentLost(f"{reply.slug}: {reply.text}")
        raise RefusedError(f"the learner refused what this {self.role} sent: {reply.slug}: {reply.text}")

    def _on_orders(self, key: str, data: bytes) -> None:
        try:
            orders = Orders.decode(data)
        except CodecError:
            return  # the learner repeats its orders twice a second
        with self._changed:
            self._orders = orders
            self._changed.notify_all()

    def _on_learner(self, key: str, alive: bool) -> None:
        role, _ = parse_alive(key)
        with self._changed:
            # Never reset: a learner that was unreachable saw this worker disappear, too, and has freed its slot.
            self._learner_gone |= role == "learner" and not alive
            self._changed.notify_all()


def _differ(new: Orders, old: Orders | None) -> bool:
    """True if two orders ask for different work; the time of sending does not count."""
    if old is None:
        return True
    return (new.version, new.digest, new.collect, new.evaluate, new.finished) != (
        old.version,
        old.digest,
        old.collect,
        old.evaluate,
        old.finished,
    )
