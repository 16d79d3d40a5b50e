"""Rollouts on their way into the log.

One is answered `accepted` by the log's thread once it is in the log, `busy` where the queue is full, `refused` where it
is no use.
"""

from __future__ import annotations

import threading
import time

from common.config.settings import RunSettings
from common.errors import CodecError, LogWriteError
from common.log.writer import LogWriter
from common.runs.rollout_shape import rollout_shape
from common.wire.keys import Keys
from common.wire.messages import PushReply, Rollout
from common.wire.session import Request
from services.learner.endpoints.environments import LOG_FAILED
from services.learner.endpoints.monitor import RunMonitor
from services.learner.scheduling.fleet import Fleet
from services.learner.scheduling.slots import ACCEPTED


class RolloutHandler:
    """Answers on `rollout/<slot>`.

    Args:
        changed: the condition that guards `fleet` and `census`, told when the fleet has something new; nothing here
            waits under it.
    """

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        log: LogWriter,
        fleet: Fleet,
        census: RunMonitor,
        changed: threading.Condition,
    ) -> None:
        self._keys = Keys(run)
        self._shape = rollout_shape(settings)
        self._queue_bytes = settings.transport.queue_bytes
        self._log = log
        self._fleet = fleet
        self._monitor = census
        self._changed = changed

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
            rollout = Rollout.decode(request.payload)
            rollout.check(self._shape)
            if request.key != self._keys.rollout(rollout.slot):
                raise CodecError("bad_key", f"a rollout of slot {rollout.slot} was pushed on {request.key}")
        except CodecError as error:
            return PushReply("refused", f"{error.reason}: {error}")
        if self._log.pending_bytes + len(request.payload) > self._queue_bytes:
            return PushReply("busy", "the learner's queue is full")
        with self._changed:
            answer = self._fleet.admit(rollout)
            self._changed.notify_all()  # one that the log has already counts at once
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
            self._monitor.accepted(rollout.slot)
            self._changed.notify_all()
        request.reply(ACCEPTED.encode())
