"""A recorded run on the keys of a live one: the messages that a subscriber would have received, from the log."""

from __future__ import annotations

import time

from common.errors import CodecError
from common.log.reader import LogMessage
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import RecordedUpdate
from common.wire.keys import JOIN, Keys, parse_alive
from common.wire.messages import Join, JoinReply, Orders, PushReply, Snapshot
from common.wire.report import Progress
from common.wire.rollout import Rollout
from common.wire.session import Publisher, Request, Session
from services.learner.reporting.statistics import Episodes, TrainingReturn, step_reward


class Player:
    """Publishes messages of a log as the learner that wrote it did.

    `/update` goes out on `metrics`, with the `status` after it; a `/policy` is served on `policy/latest` and announced
    on `policy/notify`. Rollouts are put on `rollout/<slot>`, which in a live run are queries that only the learner
    gets. The other topics of a log have no key. Nothing is dropped where a subscriber is slow.

    Evaluators may join, as they join a learner. Their assessments are acknowledged and not kept.
    """

    def __init__(self, run: RecordedRun, session: Session) -> None:
        self._run = run
        self._keys = Keys(run.run)
        self._session = session
        self._snapshot = b""
        self._finished = False
        self._returns = TrainingReturn(run.settings.updates)
        self._began_ns: int | None = None
        self._metrics = session.publisher(self._keys.metrics, patient=True)
        self._status = session.publisher(self._keys.status, patient=True)
        self._notify = session.publisher(self._keys.policy_notify, patient=True)
        self._rollouts: dict[int, Publisher] = {}
        session.serve(JOIN, self._on_join)
        session.serve(self._keys.assessments, _acknowledge)
        session.watch_alive(self._keys.all_alive, self._on_alive)
        session.declare_alive(self._keys.alive("learner", "learner"))

    def play(self, message: LogMessage, content: RecordedUpdate | Rollout | None) -> None:
        """Publish one message of the log; `content` as `RecordedRun.messages` has it."""
        if isinstance(content, RecordedUpdate):
            self._metrics.put(message.data)
            self._show(content)
        elif isinstance(content, Rollout):
            self._began_ns = self._began_ns or message.t_ns
            if content.slot not in self._rollouts:
                self._rollouts[content.slot] = self._session.publisher(self._keys.rollout(content.slot), patient=True)
            self._rollouts[content.slot].put(message.data)
        elif message.topic == "/policy":
            first, self._snapshot = not self._snapshot, message.data
            if first:
                self._session.serve(self._keys.policy_latest, lambda request: request.reply(self._snapshot))
            self._announce(finished=False)

    def finish(self) -> None:
        """Announce that the run is over, as a learner does at its end."""
        self._finished = True
        if self._snapshot:
            self._announce(finished=True)

    def _on_join(self, request: Request) -> None:
        try:
            join = Join.decode(request.payload)
        except CodecError as error:
            request.reply(self._refusal("malformed", str(error)))
            return
        if join.run not in ("", self._run.run):
            request.reply(self._refusal("run", f"this is a replay of run {self._run.run!r}, not of {join.run!r}"))
        elif join.role != "evaluator":
            request.reply(
                self._refusal("replay", f"this is a replay of run {self._run.run!r}: only evaluators can join")
            )
        else:
            settings = self._run.settings.model_dump_json()
            request.reply(JoinReply.granted(self._run.run, 0, 0, settings).encode())

    def _refusal(self, slug: str, text: str) -> bytes:
        return JoinReply.refused(self._run.run, slug, text, final=True).encode()

    def _on_alive(self, key: str, alive: bool) -> None:
        """Repeat the announcement for an evaluator that has just joined: the next policy may be long in coming."""
        role, _ = parse_alive(key)
        if role == "evaluator" and alive and self._snapshot:
            self._announce(finished=self._finished)

    def _show(self, update: RecordedUpdate) -> None:
        settings = self._run.settings
        self._returns.add(update.version, Episodes.of(update.rollouts))
        trained_s = (update.t_ns - (self._began_ns or update.t_ns)) / 1e9
        progress = Progress(
            phase="training",
            text="replayed from the log",
            version=update.version,
            updates=settings.updates,
            env_steps=update.env_steps,
            total_steps=settings.updates * settings.batch_size,
            steps_per_s=update.env_steps / trained_s if trained_s else None,
            train_return=self._returns.newest,
            step_reward=step_reward(update.rollouts),
            staleness=update.staleness.get("max", 0.0),
            centres=round(update.metrics.get("rkhs/centres") or 0),
            capacity=settings.capacity,
            actors=len({rollout.slot for rollout in update.rollouts}),
            slots=settings.actors,
        )
        self._status.put(progress.encode())

    def _announce(self, *, finished: bool) -> None:
        snapshot = Snapshot.decode(self._snapshot)
        orders = Orders(
            run=snapshot.run,
            version=snapshot.version,
            digest=snapshot.digest,
            size=len(self._snapshot),
            collect={},
            evaluate={},
            finished=finished,
            t_ns=time.time_ns(),
        )
        self._notify.put(orders.encode())


def _acknowledge(request: Request) -> None:
    request.reply(PushReply("accepted").encode())
