"""The learner's loop: collect, update, publish, log, until the run is done or asked to stop.

The loop is a generator of updates; what is made of each (log, events, display, checkpoints) stands beside it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass

from common.config.settings import RunSettings
from common.log.records import encode_json
from common.log.writer import LogWriter
from common.wire.messages import Evaluation, Rollout
from common.wire.report import Progress
from services.learner.endpoints.hub import Hub
from services.learner.reporting.display import Display
from services.learner.reporting.evaluations import scalars as evaluation_scalars
from services.learner.reporting.public import public_update
from services.learner.reporting.scalars import Scalars
from services.learner.reporting.statistics import Episodes, actor_seconds, step_reward
from services.learner.resume.resumed_replay import ResumedReplay
from services.learner.training.checkpoints import Checkpoints, KeptEnvironments
from services.learner.training.snapshots import make_snapshot
from services.learner.training.trainer import Trainer

TICK_S = 0.5
"""How often a waiting learner repeats its orders and looks after its actors."""

FLUSH_S = 60.0
"""How long the log may take to be written before environments are kept."""

FAREWELL_S = 3.0
"""How long actors are given to hear that the run is over."""


@dataclass(frozen=True)
class Step:
    """One update and what went into it. `seconds` is by phase; `log` ran beside the others."""

    version: int
    digest: str
    rollouts: list[Rollout]
    metrics: dict[str, float]
    seconds: dict[str, float]
    logged: bool
    """Whether a resumed run's log has it already."""

    @property
    def staleness(self) -> dict[str, float]:
        """Versions between the policies that made the rollouts and the one that was updated: min, mean, max."""
        behind = [self.version - 1 - rollout.policy_version for rollout in self.rollouts]
        return {"min": min(behind), "mean": sum(behind) / len(behind), "max": max(behind)}


class Run:
    """One training run from its first version to its last."""

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        trainer: Trainer,
        hub: Hub,
        log: LogWriter,
        display: Display,
        scalars: Scalars,
        stop: threading.Event,
        checkpoints: Checkpoints,
        resumed_replay: ResumedReplay,
    ) -> None:
        self._run = run
        self._settings = settings
        self._trainer = trainer
        self._hub = hub
        self._log = log
        self._display = display
        self._scalars = scalars
        self._stop = stop
        self._checkpoints = checkpoints
        self._resumed_replay = resumed_replay
        self.returns = resumed_replay.returns(settings.updates)
        self.physics: set[str] = set()
        self.digest = trainer.digest()
        self.trained_s = 0.0
        self._began_s: float | None = None
        self._began_version = 0
        self._centres = 0
        self._staleness = 0.0
        self._step_reward: float | None = None
        self._log_busy_s = 0.0

    @property
    def env_steps(self) -> int:
        return self._trainer.version * self._settings.batch_size

    @property
    def steps_per_s(self) -> float | None:
        """Environment steps a second since the first new rollout was begun; None before the first update of it."""
        steps = (self._trainer.version - self._began_version) * self._settings.batch_size
        return steps / self.trained_s if self.trained_s else None

    def train(self) -> bool:
        """All updates; whether they were all made (else the run was asked to stop)."""
        self._publish()
        self._hub.open()
        self._compile()
        for step in self._steps():
            self._record(step)
        return self._trainer.version == self._settings.updates

    def evaluate(self) -> Evaluation | None:
        """The final policy without exploration noise, by one of the actors; None where stopped or not wanted."""
        episodes = self._settings.evaluation.episodes
        if not episodes:
            return None
        self._hub.ask_for_evaluation(episodes)
        while not self._stop.is_set():
            evaluation = self._hub.evaluation(TICK_S)
            if evaluation is not None:
                return evaluation
            self._tick("evaluating", f"{episodes} episodes with the deterministic policy")
        return None

    def dismiss(self) -> None:
        """Tell the actors that the run is over, and give them a moment to leave."""
        deadline = time.monotonic() + FAREWELL_S
        while True:
            self._hub.finish()
            if not (self._hub.actors() or self._hub.standing_by()) or time.monotonic() > deadline:
                return
            time.sleep(0.1)

    def draw_evaluations(self) -> None:
        """Add what evaluators have brought to the curves."""
        for record in self._hub.evaluators.fresh():
            self._scalars.add(record["env_steps"], evaluation_scalars(record))

    # -- the loop ------------------------------------------------------------------------------------------

    def _steps(self) -> Iterator[Step]:
        while self._trainer.version < self._settings.updates:
            asked_s = time.monotonic()
            rollouts = self._collect()
            if rollouts is None:
                return
            got_s = time.monotonic()
            logged = self._resumed_replay.covers(self._trainer.version)
            if self._began_s is None and not logged:
                self._began_s = got_s - max(sum(rollout.timing.values()) for rollout in rollouts)
                self._began_version = self._trainer.version
            environments = self._hub.environments.kept()
            metrics = self._trainer.update(rollouts)
            updated_s = time.monotonic()
            snapshot = self._publish()
            published_s = time.monotonic()
            self.trained_s = 0.0 if self._began_s is None else updated_s - self._began_s
            version = self._trainer.version
            # The actors are at work again; what follows costs the run nothing.
            self.digest = self._trainer.digest()
            self._resumed_replay.check(version, self.digest)
            self._keep(version, snapshot, environments)
            seconds = {
                "wait": got_s - asked_s,
                "learner": updated_s - got_s,
                "publish": published_s - updated_s,
                "record": time.monotonic() - published_s,
                "log": self._log_seconds(),
            }
            yield Step(version, self.digest, rollouts, metrics, seconds | _prefixed(actor_seconds(rollouts)), logged)

    def _keep(self, version: int, snapshot: bytes, environments: KeptEnvironments | None) -> None:
        """Policy, checkpoint, and the environments of the version before, which its checkpoint goes on from."""
        log = self._settings.log
        last = version == self._settings.updates
        if (version % log.policy_every == 0 or last) and not self._resumed_replay.holds("/policy", version):
            self._log.write("/policy", snapshot)
        if environments is not None:
            # Whoever finds them finds the update to their version in the log.
            self._log.flush(timeout_s=FLUSH_S)
            self._checkpoints.keep_environments(environments)
        if version % log.checkpoint_every == 0 or last:
            self._checkpoints.keep(version, self._trainer.state_arrays())

    def _log_seconds(self) -> float:
        """Seconds the log's thread was at work since the last call, beside the loop."""
        before, self._log_busy_s = self._log_busy_s, self._log.busy_s
        return self._log_busy_s - before

    def _compile(self) -> None:
        """Compile the update while the actors join and compile theirs."""
        began_s = time.monotonic()
        with ThreadPoolExecutor(1, "compile") as pool:
            compiled = pool.submit(self._trainer.compile)
            while not compiled.done():
                self._tick("compiling", f"the update {time.monotonic() - began_s:.0f} s; {self._hub.waiting_for()}")
                wait([compiled], TICK_S)
            compiled.result()

    def _collect(self) -> list[Rollout] | None:
        """The rollouts of this version; None when the run is asked to stop."""
        version = self._trainer.version
        while not self._stop.is_set():
            if (rollouts := self._resumed_replay.by_log(version) or self._hub.rollouts(TICK_S)) is not None:
                return rollouts
            if self._resumed_replay.give_up_acting(version):
                continue
            self._tick("training" if self._trainer.version else "starting", self._hub.waiting_for())
        return None

    def _tick(self, phase: str, text: str) -> None:
        self._hub.announce()
        self._hub.drop_silent()
        self._hub.excuse_absent()
        self._show(phase, text)

    def _publish(self) -> bytes:
        snapshot = make_snapshot(self._run, self._trainer.version, self._trainer.policy_arrays())
        return self._resumed_replay.begin(snapshot, self._settings)

    # -- what is made of an update -------------------------------------------------------------------------

    def _record(self, step: Step) -> None:
        episodes = Episodes.of(step.rollouts)
        self.returns.add(step.version, episodes)
        self.physics |= self._hub.engines()
        self._centres = round(step.metrics.get("rkhs/centres", 0))
        self._staleness = step.staleness["mean"]
        self._step_reward = step_reward(step.rollouts)
        if not step.logged:
            self._write(step, episodes)
        self._show("training", "")

    def _write(self, step: Step, episodes: Episodes) -> None:
        record = episodes.record(step.version)
        if record is not None and not self._resumed_replay.holds("/episode", step.version):
            self._log.write("/episode", record)
        update = {
            "version": step.version,
            "env_steps": self.env_steps,
            "rollouts": [
                {
                    "slot": rollout.slot,
                    "incarnation": rollout.incarnation,
                    "generation": rollout.generation,
                    "seq": rollout.seq,
                    "policy_version": rollout.policy_version,
                }
                for rollout in step.rollouts
            ],
            "state_digest": step.digest,
            "metrics": step.metrics,
            "seconds": step.seconds,
            "staleness": step.staleness,
        }
        self._log.write("/update", update)
        self._hub.publish_metrics(encode_json(public_update(update)))
        self._scalars.add(
            self.env_steps,
            step.metrics
            | {f"seconds/{name}": value for name, value in step.seconds.items()}
            | {f"staleness/{name}": value for name, value in step.staleness.items()}
            | {
                "run/steps_per_s": self.steps_per_s,
                "run/return": self.returns.newest,
                "run/step_reward": self._step_reward,
            },
        )

    def _show(self, phase: str, text: str) -> None:
        progress = Progress(
            phase=phase,
            text=text,
            version=self._trainer.version,
            updates=self._settings.updates,
            env_steps=self.env_steps,
            total_steps=self._settings.updates * self._settings.batch_size,
            steps_per_s=self.steps_per_s,
            train_return=self.returns.newest,
            step_reward=self._step_reward,
            staleness=self._staleness,
            centres=self._centres,
            capacity=self._settings.capacity,
            actors=self._hub.actors(),
            slots=self._settings.actors,
        )
        self._display.show(progress)
        self._hub.publish_progress(progress)
        self.draw_evaluations()


def _prefixed(seconds: dict[str, float]) -> dict[str, float]:
    return {f"actor/{name}": value for name, value in seconds.items()}
