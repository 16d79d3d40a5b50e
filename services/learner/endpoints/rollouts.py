"""Pushed rollouts: each is checked, logged, and then counted.

The answer is `accepted` once the rollout is in the log, `busy` where the queue is full, `refused` where it is of no
use.
"""

from __future__ import annotations

import threading
import time

from common.config.settings import RunSettings
from common.errors import CodecError, LogWriteError
from common.log.writer import LogWriter
from common.runs.rollout_shape import rollout_shape
from common.wire.codec import Limits
from common.wire.keys import Keys
from common.wire.messages import ACCEPTED, PushReply, Snapshot
from common.wire.rollout import Rollout
from common.wire.session import Request
from services.learner.endpoints.log_probs import LogProbabilityCheck, check_log_probs
from services.learner.endpoints.monitor import RunMonitor
from services.learner.endpoints.replies import LOG_FAILED, QUEUE_FULL
from services.learner.scheduling.failing_policy import FailingPolicy
from services.learner.scheduling.fleet import Fleet


class RolloutHandler:
    """Serves `rollout/<slot>`.

    Args:
        changed: the condition that guards `fleet` and `monitor`, notified when the fleet has something new; nothing
            here waits under it.
    """

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        log: LogWriter,
        fleet: Fleet,
        monitor: RunMonitor,
        changed: threading.Condition,
    ) -> None:
        self._keys = Keys(run)
        self._shape = rollout_shape(settings)
        self._limits = Limits(max_message=self._shape.max_bytes)
        self._queue_bytes = settings.transport.queue_bytes
        self._log = log
        self._fleet = fleet
        self._monitor = monitor
        self._changed = changed
        self._failing = FailingPolicy()
        self._log_probs = LogProbabilityCheck()

    def published(self, snapshot: Snapshot) -> None:
        """Note a policy that rollouts may be made with from now on. Under the condition, as `policy_problem`."""
        self._log_probs.published(snapshot.version, snapshot.arrays)

    def policy_problem(self) -> str | None:
        """As `FailingPolicy.problem`, under the condition."""
        return self._failing.problem

    def on_request(self, request: Request) -> None:
        """A handler of the session: never waits."""
        reply = self._take(request)
        if reply is not None:
            with self._changed:
                self._monitor.answered(request.key, reply, time.monotonic())
            request.reply(reply.encode())

    def _take(self, request: Request) -> PushReply | None:
        """The answer to a pushed rollout, or None where the log's thread will give it."""
        try:
            rollout = Rollout.decode(request.payload, self._limits)
        except CodecError as error:
            return PushReply.of(error)
        try:
            rollout.check(self._shape)
            rollout.check_magnitudes()
            with self._changed:
                log_std = self._log_probs.log_std(rollout.policy_version)
            check_log_probs(rollout, log_std)
            if request.key != self._keys.rollout(rollout.slot):
                raise CodecError("bad_key", f"a rollout of slot {rollout.slot} was pushed on {request.key}")
        except CodecError as error:
            with self._changed:
                if self._fleet.holds(rollout.slot, rollout.incarnation):
                    self._failing.refused(error.reason, rollout, self._fleet.version)
            return PushReply.of(error)
        if self._log.pending_bytes + len(request.payload) > self._queue_bytes:
            return QUEUE_FULL
        with self._changed:
            answer = self._fleet.admit(rollout)
            self._changed.notify_all()  # a rollout that the log has already counts at once
        if answer is None:
            try:
                self._log.write("/rollout", request.payload, on_durable=lambda: self._logged(rollout, request))
            except LogWriteError:
                return LOG_FAILED
        return answer

    def _logged(self, rollout: Rollout, request: Request) -> None:
        """On the log's thread: the rollout is in the file."""
        with self._changed:
            self._fleet.accept(rollout)
            self._failing.accepted(rollout, self._fleet.version)
            self._monitor.accepted(rollout.slot)
            self._changed.notify_all()
        request.reply(ACCEPTED.encode())
