"""The run's own evaluation at its end, as the actor that was asked for it sends it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from common.errors import CodecError
from common.wire.keys import Keys
from common.wire.messages import ACCEPTED, Evaluation, PushReply
from common.wire.session import Request
from services.learner.endpoints.admission import check_evaluation
from services.learner.endpoints.motions import MotionLog
from services.learner.scheduling.fleet import Fleet


class FinalEvaluationHandler:
    """Serves `evaluation/<slot>`.

    Args:
        changed: the condition that guards `fleet`; nothing in `on_request` waits under it.
    """

    def __init__(
        self,
        keys: Keys,
        fleet: Fleet,
        motions: MotionLog,
        changed: threading.Condition,
        on_refused: Callable[[CodecError], None],
    ) -> None:
        self._keys = keys
        self._fleet = fleet
        self._motions = motions
        self._changed = changed
        self._on_refused = on_refused
        self._evaluation: Evaluation | None = None

    def wait(self, timeout_s: float) -> Evaluation | None:
        """The evaluation asked for, or None when it did not come within the time."""
        with self._changed:
            self._changed.wait_for(lambda: self._evaluation is not None, timeout_s)
            return self._evaluation

    def on_request(self, request: Request) -> None:
        """A handler of the session: never waits."""
        try:
            evaluation = Evaluation.decode(request.payload)
            self._motions.read(evaluation.motions, evaluation.version, evaluation.episode_length)
            with self._changed:
                check_evaluation(self._fleet, self._keys, request.key, evaluation)
                if self._evaluation is None:
                    self._evaluation = evaluation
                    self._changed.notify_all()
        except CodecError as error:
            self._on_refused(error)
            request.reply(PushReply.of(error).encode())
            return
        request.reply(ACCEPTED.encode())
