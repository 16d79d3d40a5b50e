"""The connection of an evaluator to its learner: assessments out."""

from __future__ import annotations

import threading
from typing import final

from common.wire.assessment import Assessment
from common.wire.session import Session
from services.worker.joining import Assignment, Role
from services.worker.link import WorkerLink


@final
class EvaluatorLink(WorkerLink):
    """The messages of one incarnation of an evaluator, which holds no slot."""

    def __init__(self, session: Session, assignment: Assignment, *, push_timeout_s: float) -> None:
        super().__init__(session, assignment, push_timeout_s=push_timeout_s)
        self._key = self._keys.assessment(assignment.incarnation)

    @property
    def role(self) -> Role:
        return "evaluator"

    def push(self, assessment: Assessment, stop: threading.Event) -> bool:
        """Send an assessment until the learner answers; True if it was logged, False on `stop`.

        Raises:
            AssignmentLost: the learner is gone or no longer knows this evaluator.
            RefusedError: the assessment is malformed, so that sending it again would not help.
        """
        return self._push(self._key, assessment.encode(), stop)
