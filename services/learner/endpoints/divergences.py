"""Diverged simulations: their last steps go to the log, a bounded number in a run."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from common.config.settings import RunSettings
from common.errors import CodecError, LogWriteError
from common.log.writer import LogWriter
from common.wire.divergence import Divergence
from common.wire.keys import Keys
from common.wire.messages import ACCEPTED, PushReply
from common.wire.session import Request
from services.learner.endpoints.admission import check_holder
from services.learner.endpoints.motions import motion_sizes
from services.learner.endpoints.rate_limit import RateLimit
from services.learner.endpoints.replies import LOG_FAILED, QUEUE_FULL
from services.learner.scheduling.fleet import Fleet

BURST, PER_S = 4, 1 / 30
"""Records taken in at once and in the long run, so that those of a run are not all of one moment."""

ENOUGH = PushReply.refused("surplus", "the log has as many diverged simulations as it is to have")
NOT_NOW = PushReply.refused("surplus", "the log has had enough diverged simulations for the moment")


class DivergenceHandler:
    """Serves `divergence/<slot>`.

    Args:
        changed: the condition that guards `fleet`; nothing here waits under it.
        logged: records that the log of a resumed run has already.
    """

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        log: LogWriter,
        fleet: Fleet,
        changed: threading.Condition,
        on_refused: Callable[[CodecError], None],
        logged: int = 0,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._run = run
        self._keys = Keys(run)
        self._sizes = motion_sizes(settings.sizes)
        self._steps, self._envs = settings.num_steps, settings.envs_per_actor
        self._queue_bytes = settings.transport.queue_bytes
        self._log = log
        self._fleet = fleet
        self._changed = changed
        self._on_refused = on_refused
        self._left = settings.log.divergences - logged
        self._rate = RateLimit(BURST, PER_S, clock_s)

    def on_request(self, request: Request) -> None:
        """A handler of the session: never waits."""
        reply = self._take(request)
        if reply is not None:
            request.reply(reply.encode())

    def _take(self, request: Request) -> PushReply | None:
        """The answer to a record, or None where the log's thread will give it."""
        try:
            given = Divergence.decode(request.payload)
            self._check(given, request.key)
        except CodecError as error:
            self._on_refused(error)
            return PushReply.of(error)
        if self._log.pending_bytes + len(request.payload) > self._queue_bytes:
            return QUEUE_FULL
        with self._changed:
            if self._left <= 0:
                return ENOUGH
            if not self._rate.take(1):
                return NOT_NOW
            self._left -= 1
        try:
            self._log.write("/divergence", request.payload, on_durable=lambda: request.reply(ACCEPTED.encode()))
        except LogWriteError:
            return LOG_FAILED
        return None

    def _check(self, given: Divergence, key: str) -> None:
        """Raises CodecError unless the record is of the actor that holds its slot, and of the run's sizes."""
        if key != self._keys.divergence(given.slot):
            raise CodecError("bad_key", f"a divergence of slot {given.slot} was pushed on {key}")
        with self._changed:
            check_holder(self._fleet, self._run, given)
        if given.step >= self._steps or given.env >= self._envs:
            raise CodecError(
                "bad_value",
                f"step {given.step} of environment {given.env}; rollouts have {self._steps} of {self._envs}",
            )
        sizes = given.qpos.shape[1], given.qvel.shape[1], given.action.shape[1]
        if sizes != self._sizes:
            raise CodecError("bad_shape", f"a divergence of sizes {sizes}; the task has {self._sizes}")
