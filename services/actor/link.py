"""The connection of an actor to its learner: rollouts, evaluations, environments and heartbeats out."""

from __future__ import annotations

import threading
from typing import final

from common.errors import CodecError, SessionError
from common.wire.divergence import Divergence
from common.wire.messages import Environment, Evaluation, Heartbeat
from common.wire.rollout import Rollout
from common.wire.session import Session
from services.worker.joining import Assignment, Role
from services.worker.link import AssignmentLost, WorkerLink


@final
class ActorLink(WorkerLink):
    """The messages of one incarnation of an actor, which holds a slot."""

    def __init__(self, session: Session, assignment: Assignment, *, push_timeout_s: float) -> None:
        self._slot = assignment.slot
        super().__init__(session, assignment, push_timeout_s=push_timeout_s)
        self._heartbeats = session.publisher(self._keys.heartbeat(self._slot), express=True, high_priority=True)

    @property
    def role(self) -> Role:
        return "actor"

    def environment(self) -> Environment:
        """The environments that the slot continues from. Raises AssignmentLost if the learner keeps none for it."""
        key = self._keys.environment(self._slot)
        try:
            return Environment.decode(self._session.ask(key, b"", self._push_timeout_s))
        except (SessionError, CodecError) as error:
            raise AssignmentLost(f"no environments from the learner: {error}") from None

    def push(self, rollout: Rollout, stop: threading.Event) -> bool:
        """Send a rollout until the learner answers; True if it was accepted, False if it came too late or on `stop`.

        Raises:
            AssignmentLost: the learner is gone or no longer knows this incarnation.
            RefusedError: the rollout is malformed, so that sending it again would not help.
        """
        return self._push(self._keys.rollout(self._slot), rollout.encode(), stop)

    def push_evaluation(self, evaluation: Evaluation, stop: threading.Event) -> bool:
        """Send an evaluation; as `push`."""
        return self._push(self._keys.evaluation(self._slot), evaluation.encode(), stop)

    def push_environment(self, environment: Environment, stop: threading.Event) -> bool:
        """Send the state of the slot's environments; as `push`."""
        return self._push(self._keys.environment(self._slot), environment.encode(), stop)

    def push_divergence(self, divergence: Divergence, stop: threading.Event) -> bool:
        """Send the last steps of a diverged simulation; as `push`, and False where the log has enough of them."""
        return self._push(self._keys.divergence(self._slot), divergence.encode(), stop)

    def send_heartbeat(self, heartbeat: Heartbeat) -> None:
        """Publish a heartbeat; there is no answer."""
        self._heartbeats.put(heartbeat.encode())
