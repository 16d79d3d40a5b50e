"""Evaluators: processes that are given the settings and policies, and push figures for the log.

They take no part in training: they hold no slot, are never waited for, and their figures go to the log and to the
curves alone.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from common.config.settings import RunSettings
from common.errors import CodecError, RefusedError
from common.log.writer import LogWriter
from common.printable import quoted, shortened
from common.wire.assessment import Assessment
from common.wire.keys import Keys
from common.wire.messages import ACCEPTED, PushReply
from common.wire.report import EvaluationReport
from common.wire.session import Request
from services.learner.endpoints.motions import MotionLog
from services.learner.endpoints.rate_limit import RateLimit
from services.learner.endpoints.replies import QUEUE_FULL
from services.learner.reporting.evaluations import eval_record, source_of, trajectory_record
from services.learner.scheduling.fleet import Fleet

MAX_EVALUATORS = 16
UNSEEN_S = 30.0
"""An evaluator that joined and declared no liveliness token within this time makes room for another."""

BURST_BYTES, BYTES_PER_S = 4 << 20, 256 << 10
"""Of the assessments of all evaluators; in the log, as JSON, they take up to twelve times as much."""

TOO_FAST = PushReply.busy("rate_limited", "evaluators push more than the log is to hold: send it later")


@dataclass
class _Member:
    joined_s: float
    seen: bool = False
    versions: set[int] = field(default_factory=set)
    """Versions whose assessment is logged, or being logged."""


@dataclass(frozen=True)
class _Newest:
    record: dict[str, Any]
    at_s: float


class EvaluatorHandler:
    """Serves `assessment/<id>`. Each evaluator's figures for a version are logged once, however often they are pushed.

    Args:
        changed: the condition that guards `fleet`; nothing here waits under it.
        motions: takes the trajectories.
    """

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        log: LogWriter,
        fleet: Fleet,
        changed: threading.Condition,
        on_refused: Callable[[CodecError], None],
        motions: MotionLog,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._run = run
        self._keys = Keys(run)
        self._queue_bytes = settings.transport.queue_bytes
        self._batch_size = settings.batch_size
        self._log = log
        self._motions = motions
        self._fleet = fleet
        self._changed = changed
        self._on_refused = on_refused
        self._clock_s = clock_s
        self._members: dict[str, _Member] = {}
        self._rate = RateLimit(BURST_BYTES, BYTES_PER_S, clock_s)
        self._newest: _Newest | None = None
        self._fresh: deque[dict[str, Any]] = deque()

    # -- under the condition -------------------------------------------------------------------------------

    def join(self, incarnation: str) -> None:
        """Admit an evaluator. RefusedError where there is no room. Under the condition, as `seen` and `report`."""
        now_s = self._clock_s()
        if incarnation not in self._members and len(self._members) >= MAX_EVALUATORS:
            unseen = [name for name, at in self._members.items() if not at.seen and now_s - at.joined_s > UNSEEN_S]
            if not unseen:
                raise RefusedError(f"all {MAX_EVALUATORS} places for evaluators are taken; end one of them")
            for name in unseen:
                del self._members[name]
        self._members.setdefault(incarnation, _Member(now_s))

    def seen(self, incarnation: str, alive: bool) -> None:
        """Record that an evaluator's liveliness token has appeared or gone; tokens of unknown ones are ignored."""
        if incarnation not in self._members:
            return
        if alive:
            self._members[incarnation].seen = True
        else:
            del self._members[incarnation]

    def report(self) -> tuple[int, EvaluationReport | None]:
        """The number of evaluators present, and the newest evaluation of any."""
        here = sum(member.seen for member in self._members.values())
        if self._newest is None:
            return here, None
        record = self._newest.record
        behind = max(0, self._fleet.version - record["version"])
        aged = record | {"behind": behind, "ago_s": self._clock_s() - self._newest.at_s}
        return here, EvaluationReport.model_validate(aged)

    # -- outside the condition -----------------------------------------------------------------------------

    def fresh(self) -> list[dict[str, Any]]:
        """The `/eval` records since the last call."""
        with self._changed:
            found = list(self._fresh)
            self._fresh.clear()
            return found

    def on_request(self, request: Request) -> None:
        """A handler of the session: never waits."""
        reply = self._take(request)
        if reply is not None:
            request.reply(reply.encode())

    def _take(self, request: Request) -> PushReply | None:
        """The answer to an assessment, or None where the log's thread will give it."""
        try:
            given = Assessment.decode(request.payload)
            if request.key != self._keys.assessment(given.evaluator):
                raise CodecError(
                    "bad_key",
                    "an assessment was pushed on the key of another evaluator",
                )
            motions = self._motions.read(given.motions, given.version, given.episode_length)
            if self._log.pending_bytes + len(request.payload) > self._queue_bytes:
                return QUEUE_FULL
            with self._changed:
                if not self._is_new(given):
                    return ACCEPTED
                if not self._rate.take(len(request.payload)):
                    return TOO_FAST
                self._members[given.evaluator].versions.add(given.version)
                record = self._record(given)
        except CodecError as error:
            self._on_refused(error)
            return PushReply.of(error)
        if len(given.qpos):
            self._log.write("/trajectory", trajectory_record(given))
        self._motions.write(motions, source_of(given.evaluator))
        self._log.write("/eval", record, on_durable=lambda: self._logged(record, request))
        return None

    def _is_new(self, given: Assessment) -> bool:
        """True if the assessment is to be logged: False for a duplicate. CodecError where it is not wanted."""
        member = self._members.get(given.evaluator)
        if member is None or given.run != self._run:
            raise CodecError(
                "incarnation", f"{quoted(shortened(given.evaluator))} is no evaluator of this run; join again"
            )
        if self._fleet.finished:
            raise CodecError("stale", "the run is over")
        if given.version > self._fleet.version:
            raise CodecError("bad_value", f"version is {given.version}; the newest is {self._fleet.version}")
        return given.version not in member.versions

    def _record(self, given: Assessment) -> dict[str, Any]:
        return eval_record(
            given.version,
            given.version * self._batch_size,
            given.episode_return,
            given.episode_length,
            source=source_of(given.evaluator),
            behind=self._fleet.version - given.version,
        )

    def _logged(self, record: dict[str, Any], request: Request) -> None:
        """On the log's thread: the record is in the file."""
        with self._changed:
            self._newest = _Newest(record, self._clock_s())
            self._fresh.append(record)
        request.reply(ACCEPTED.encode())
