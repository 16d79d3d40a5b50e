"""The learner's side of every exchange: orders, snapshots, heartbeats, and a handler for each kind of request.

Handlers run on Zenoh's threads. They check and enqueue, under one lock, and never wait.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial

from common.config.settings import RunSettings
from common.errors import CodecError
from common.log.writer import LogWriter
from common.printable import printable, shortened
from common.wire.keys import JOIN, STATUS, Keys, parse_alive
from common.wire.messages import Evaluation, Heartbeat, Snapshot
from common.wire.report import Progress, RunReport
from common.wire.rollout import Rollout
from common.wire.session import Request, Session
from services.learner.endpoints.admission import check_heartbeat
from services.learner.endpoints.divergences import DivergenceHandler
from services.learner.endpoints.environments import EnvironmentHandler
from services.learner.endpoints.evaluators import EvaluatorHandler
from services.learner.endpoints.final_evaluation import FinalEvaluationHandler
from services.learner.endpoints.joins import JoinHandler
from services.learner.endpoints.monitor import RunMonitor
from services.learner.endpoints.motions import MotionLog
from services.learner.endpoints.rollouts import RolloutHandler
from services.learner.endpoints.sizes import check_snapshot_size
from services.learner.scheduling.fleet import Fleet
from services.learner.scheduling.modes import buffer_factory
from services.learner.scheduling.slots import Start

SILENT_S = 30.0
"""An actor without a heartbeat for so long loses its slot, even while it is connected."""


class Hub:
    """Joins wire, log and fleet. The learner's loop calls `publish`, `rollouts`, `evaluation` and `finish`."""

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        session: Session,
        log: LogWriter,
        on_event: Callable[[str, str, str], None],
        *,
        starts: Sequence[Start] = (),
        logged_environments: Collection[tuple[int, int, int]] = (),
        logged_records: Mapping[str, int] | None = None,
        serve: Callable[[str, Callable[[Request], None]], None] | None = None,
    ) -> None:
        """`on_event(level, name, text)` must not block; `logged_environments`: (version, slot, generation) of each;
        `logged_records`: the number of records in the log by topic; `serve`: in place of the session's, for status and
        joins."""
        self._run = run
        self._settings = settings
        self._session, self._serve = session, serve or session.serve
        self._on_event = on_event
        self._keys = Keys(run)
        self._changed = threading.Condition()
        # Under the condition, from here
        self._fleet = Fleet(run, settings.actors, starts, buffer_factory(settings))
        self._snapshot = b""
        self._digest = ""
        self._monitor = RunMonitor(run, settings, time.monotonic())
        self._opened_s, self._open = time.monotonic(), False
        # to here.
        self.environments = EnvironmentHandler(
            run, settings, log, self._fleet, self._changed, partial(self._refused, "environment"), logged_environments
        )
        counts = logged_records or {}
        motions = MotionLog(run, settings, log, counts.get("/motion", 0))
        refused = partial(self._refused, "assessment")
        self.evaluators = EvaluatorHandler(run, settings, log, self._fleet, self._changed, refused, motions)
        refused = partial(self._refused, "evaluation")
        self._final_evaluation = FinalEvaluationHandler(self._keys, self._fleet, motions, self._changed, refused)
        refused, logged = partial(self._refused, "divergence"), counts.get("/divergence", 0)
        self._divergences = DivergenceHandler(run, settings, log, self._fleet, self._changed, refused, logged)
        refused = partial(self._refused, "join")
        self._joins = JoinHandler(
            run, settings, self._fleet, self._monitor, self.evaluators, self._changed, refused, on_event
        )
        self._rollouts = RolloutHandler(run, settings, log, self._fleet, self._monitor, self._changed)
        self._orders = session.publisher(self._keys.policy_notify, express=True, high_priority=True)
        self._metrics = session.publisher(self._keys.metrics)
        self._status = session.publisher(self._keys.status)

    def open(self) -> None:
        """Begin to answer. The first snapshot must be there (`publish`)."""
        session, keys = self._session, self._keys
        session.serve(keys.policy_latest, self._serve_snapshot)
        session.serve(keys.rollouts, self._rollouts.on_request)
        session.serve(keys.evaluations, self._final_evaluation.on_request)
        session.serve(keys.environments, self.environments.on_request)
        session.serve(keys.assessments, self.evaluators.on_request)
        session.serve(keys.divergences, self._divergences.on_request)
        session.subscribe(keys.heartbeats, self._on_heartbeat)
        session.watch_alive(keys.all_alive, self._on_alive)
        session.declare_alive(keys.alive("learner", "learner"))
        self._serve(STATUS, lambda request: request.reply(self.report().encode()))
        self._serve(JOIN, self._joins.on_request)
        with self._changed:
            self._opened_s, self._open = time.monotonic(), True

    def is_open(self) -> bool:
        """True if requests to join are answered; blocks where they would be held up."""
        with self._changed:
            return self._open

    # -- for the learner's loop ----------------------------------------------------------------------------

    def publish(
        self,
        snapshot: Snapshot,
        *,
        collect: bool = True,
        hand_in: bool = False,
        logged: Collection[Rollout] = (),
        settled: Collection[Rollout] = (),
    ) -> bytes:
        """Publish a version and collect for it as `Fleet.begin`, or no more at all; returns the snapshot's bytes."""
        data = snapshot.encode()
        check_snapshot_size(len(data), self._settings)
        with self._changed:
            self._snapshot, self._digest = data, snapshot.digest
            overtaken = self._fleet.begin(
                snapshot.version, collect=collect, hand_in=hand_in, logged=logged, settled=settled
            )
            self._monitor.overtaken(overtaken, snapshot.version, time.monotonic())
            self._rollouts.published(snapshot)
            self.environments.forget()
            self._monitor.published(snapshot.version, time.monotonic())
        self.announce()
        return data

    def rollouts(self, timeout_s: float) -> list[Rollout] | None:
        """The rollouts of the version in their order, or None when they are not complete within the time."""
        with self._changed:
            self._changed.wait_for(lambda: self._fleet.take() or self._fleet.divergence, timeout_s)
            return None if self._fleet.divergence else self._fleet.take()

    def policy_problem(self) -> str | None:
        """The reason why no actor can act by the newest policy; None while that is not certain."""
        with self._changed:
            return self._rollouts.policy_problem()

    def divergence(self) -> str | None:
        """As `Fleet.divergence`."""
        with self._changed:
            return self._fleet.divergence

    def start_over(self, starts: Sequence[Start], settled: Collection[Rollout], *, collect: bool) -> None:
        """As `Fleet.start_over`: the orders no longer have the actors' slots, so the actors join again."""
        with self._changed:
            self._fleet.start_over(starts, settled, collect=collect)
        self.announce()

    def ask_for_evaluation(self, episodes: int) -> None:
        with self._changed:
            self._fleet.evaluate(episodes)
        self.announce()

    def evaluation(self, timeout_s: float) -> Evaluation | None:
        """The evaluation asked for, or None when it did not come within the time."""
        return self._final_evaluation.wait(timeout_s)

    def finish(self) -> None:
        """Order all actors to end: the run is over."""
        with self._changed:
            self._fleet.finish()
        self.announce()

    def announce(self) -> None:
        """Publish the orders of this moment. The loop does so repeatedly, since a put may be lost."""
        with self._changed:
            orders = self._fleet.orders(digest=self._digest, size=len(self._snapshot), t_ns=time.time_ns())
            # Under the condition, so that of two threads the one with the newer orders publishes last.
            self._orders.put(orders.encode())

    def drop_silent(self) -> None:
        """Free the slots of actors that are connected but send no heartbeat."""
        with self._changed:
            silent = self._fleet.silent(time.monotonic(), SILENT_S)
        for incarnation in silent:
            self._remove(incarnation, f"sent no heartbeat for {SILENT_S:.0f} s")

    def release_reserved(self) -> None:
        """Give the work of slots that no actor has held to others, once the time to wait for them is over."""
        wait_s = self._settings.slot_wait_s
        if wait_s is None or time.monotonic() - self._opened_s < wait_s:
            return
        with self._changed:
            released = self._fleet.release_reserved()
        if released:
            slots = ", ".join(map(str, released))
            self._on_event("info", "slots_released", f"no actor after {wait_s:g} s in slot {slots}: others do its work")
            self.announce()

    def publish_metrics(self, data: bytes) -> None:
        self._metrics.put(data)

    def publish_progress(self, progress: Progress) -> None:
        """Publish the progress for subscribers, and keep it for reports."""
        with self._changed:
            self._monitor.progressed(progress, time.monotonic())
        self._status.put(progress.encode())

    def report(self) -> RunReport:
        """The state of the run and of all its actors at this moment."""
        with self._changed:
            now_s = time.monotonic()
            report = self._monitor.report(self._fleet, self._fleet.waiting_for(now_s), now_s, time.time_ns())
            evaluators, evaluation = self.evaluators.report()
            return report.model_copy(update={"evaluators": evaluators, "evaluation": evaluation})

    def connection_refused(self, reason: str, text: str) -> None:
        """Count a client that was refused at the listener, or has no rights."""
        with self._changed:
            first = self._monitor.connection_refused(reason, text, time.monotonic())
        if first:
            self._on_event("warning", "connection_refused", f"{text}; `reskpn status` counts how often")

    def waiting_for(self) -> str:
        """As `Fleet.waiting_for`."""
        with self._changed:
            return self._fleet.waiting_for(time.monotonic())

    def engines(self) -> set[str]:
        """The physics engines of the present actors."""
        with self._changed:
            return {member.physics for _, member in self._fleet.members()}

    def actors(self) -> int:
        with self._changed:
            return len(self._fleet.members())

    def standing_by(self) -> bool:
        """As `JoinHandler.standing_by`."""
        return self._joins.standing_by()

    def refusals(self) -> dict[str, int]:
        """The number of messages that were not used, by reason."""
        with self._changed:
            return dict(self._monitor.refusals())

    # -- handlers, on Zenoh's threads ----------------------------------------------------------------------

    def _on_alive(self, key: str, alive: bool) -> None:
        try:
            role, incarnation = parse_alive(key)
        except CodecError as error:
            self._refused("alive", error)
            return
        if role == "actor" and not alive:
            self._remove(incarnation, "is gone")
        elif role == "evaluator":
            with self._changed:
                self.evaluators.seen(incarnation, alive)

    def _remove(self, incarnation: str, why: str) -> None:
        with self._changed:
            slot, over = self._fleet.remove(incarnation), self._fleet.finished
            if slot is not None:
                self._monitor.left(slot.number, time.monotonic())
            self._changed.notify_all()
        if slot is not None and not over:
            self._on_event("warning", "actor_lost", f"slot {slot.number}: {printable(shortened(incarnation))} {why}")
            self.announce()

    def _on_heartbeat(self, key: str, data: bytes) -> None:
        try:
            beat = Heartbeat.decode(data)
            with self._changed:
                check_heartbeat(self._fleet, self._keys, key, beat)
                changed = self._fleet.record_heartbeat(beat, time.monotonic())
        except CodecError as error:
            self._refused("heartbeat", error)
            return
        if changed:
            self.announce()

    def _serve_snapshot(self, request: Request) -> None:
        with self._changed:
            data = self._snapshot
        request.reply(data)

    def _refused(self, kind: str, error: CodecError) -> None:
        with self._changed:
            self._monitor.refused(kind, error.reason, str(error), time.monotonic())
