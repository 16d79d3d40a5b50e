"""An evaluator's side of its conversation with the learner."""

from __future__ import annotations

import threading

from common.wire.assessment import Assessment
from common.wire.session import Session
from services.worker.link import Following, Membership


class EvaluatorLink(Following):
    """Follows a run without a slot: orders and policies in, assessments out."""

    def __init__(self, session: Session, member: Membership, *, push_timeout_s: float) -> None:
        super().__init__(session, member.run, push_timeout_s=push_timeout_s)
        self._key = self._keys.assessment(member.incarnation)
        session.declare_alive(self._keys.alive("evaluator", member.incarnation))

    @property
    def newest(self) -> int | None:
        """The version that was published last, as far as was heard."""
        with self._changed:
            return None if self._orders is None else self._orders.version

    @property
    def over(self) -> bool:
        """Whether the learner has said that the run is over."""
        with self._changed:
            return self._orders is not None and self._orders.finished

    def push(self, assessment: Assessment, stop: threading.Event) -> bool:
        """Send until there is an answer; whether the learner logged it.

        Raises:
            Lost: the learner is gone, or does not know this evaluator any more.
            RefusedError: what was sent is malformed; sending it again would not help.
        """
        return self._push(self._key, assessment.encode(), stop)
