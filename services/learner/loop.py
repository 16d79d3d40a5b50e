"""The learner's loop: collect, update, publish, log, until the run is done or asked to stop.

The loop is a generator of updates; what records and shows them (log, curves, display) consumes it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait

from common.config.settings import RunSettings
from common.errors import NumericsError
from common.log.records import encode_json
from common.wire.messages import Evaluation
from common.wire.rollout import Rollout
from services.learner.endpoints.hub import Hub
from services.learner.reporting.curves import points_of_evaluation
from services.learner.reporting.outlets import Outlets
from services.learner.reporting.public import public_update
from services.learner.reporting.recorder import UpdateRecorder
from services.learner.reporting.summary import Outcome
from services.learner.reporting.trace import UpdateTrace, phase
from services.learner.reporting.updates import AppliedUpdate
from services.learner.resume.resumed_replay import ResumedReplay
from services.learner.resume.retention import Retention
from services.learner.training.checkpoints import Checkpoints, KeptEnvironments
from services.learner.training.snapshots import make_snapshot
from services.learner.training.trainer import Trainer

TICK_S = 0.5
"""How often a waiting learner repeats its orders and checks on its actors."""

FLUSH_S = 60.0
"""Time allowed for the log to be written before environments are kept."""

ADVICE = "a smaller algorithm.learning_rate or rkhs.eta makes smaller steps; checkpoints before that version are kept"

SHUTDOWN_S = 3.0
"""Time that actors are given to leave after the shutdown notice."""


class TrainingLoop:
    """Takes one run from its first version to its last."""

    def __init__(
        self,
        settings: RunSettings,
        trainer: Trainer,
        hub: Hub,
        outlets: Outlets,
        checkpoints: Checkpoints,
        resumed_replay: ResumedReplay,
        stop: threading.Event,
        trace: UpdateTrace | None = None,
    ) -> None:
        self._settings = settings
        self._trainer = trainer
        self._hub = hub
        self._outlets = outlets
        self._checkpoints = checkpoints
        self._resumed_replay = resumed_replay
        self._stop = stop
        self._trace = trace or UpdateTrace.none()
        self._retention = Retention(
            settings, checkpoints.run_dir, lambda text: outlets.events.log("info", "segments_removed", text)
        )
        self._recorder = UpdateRecorder(settings, outlets, resumed_replay.returns(settings.updates))
        self._physics: set[str] = set()
        self._digest = trainer.digest()
        self._trained_s = 0.0
        self._began_s: float | None = None
        self._began_version = 0
        self._log_busy_s = 0.0

    @property
    def env_steps(self) -> int:
        return self._trainer.version * self._settings.batch_size

    @property
    def steps_per_s(self) -> float | None:
        """Environment steps a second since the first new rollout was begun; None before the first update of it."""
        steps = (self._trainer.version - self._began_version) * self._settings.batch_size
        return steps / self._trained_s if self._trained_s else None

    @property
    def outcome(self) -> Outcome:
        """The run's figures up to now."""
        return Outcome(
            complete=self._trainer.version == self._settings.updates,
            env_steps=self.env_steps,
            steps_per_s=self.steps_per_s,
            returns=self._recorder.returns,
            physics=frozenset(self._physics),
            digest=self._digest,
        )

    def train(self) -> bool:
        """Make all updates. Returns False where the run was asked to stop before the last."""
        self.publish()
        self._hub.open()
        self._compile()
        for update in self._updates():
            self._record(update)
        return self._trainer.version == self._settings.updates

    def publish(self) -> bytes:
        """Publish the newest policy and say what is to be collected with it; returns the snapshot's bytes."""
        version = self._trainer.version
        snapshot = make_snapshot(self._checkpoints.run, version, self._trainer.policy_arrays())
        collect = version < self._settings.updates
        # In async mode a resumed run does not act again, so environments are not needed.
        hand_in = collect and self._settings.mode == "sync" and self._is_checkpoint(version)
        if not self._resumed_replay.reaches(version):
            return self._hub.publish(snapshot, collect=collect, hand_in=hand_in)
        left = self._resumed_replay.remaining(version)
        return self._hub.publish(
            snapshot,
            collect=collect and left.collect,
            hand_in=hand_in and left.hand_in,
            logged=left.logged,
            settled=left.settled,
        )

    def evaluate(self) -> Evaluation | None:
        """Have an actor evaluate the final policy without exploration noise; None where stopped or not wanted."""
        episodes = self._settings.evaluation.episodes
        if not episodes:
            return None
        self._hub.ask_for_evaluation(episodes)
        while not self._stop.is_set():
            evaluation = self._hub.evaluation(TICK_S)
            if evaluation is not None:
                return evaluation
            self._tick("evaluating", f"waiting for {episodes} episodes with the deterministic policy")
        return None

    def dismiss(self) -> None:
        """Send the shutdown notice to all actors, and give them a moment to leave."""
        deadline = time.monotonic() + SHUTDOWN_S
        while True:
            self._hub.finish()
            if not (self._hub.actors() or self._hub.standing_by()) or time.monotonic() > deadline:
                return
            time.sleep(0.1)

    def draw_evaluations(self) -> None:
        """Add what evaluators have sent to the curves."""
        for record in self._hub.evaluators.fresh():
            self._outlets.scalars.add(record["env_steps"], points_of_evaluation(record))
            self._outlets.scalars.flush()

    # -- the loop ------------------------------------------------------------------------------------------

    def _updates(self) -> Iterator[AppliedUpdate]:
        with self._trace:
            while self._trainer.version < self._settings.updates:
                with self._trace.update(self._trainer.version + 1):
                    update = self._update()
                    if update is None:
                        return
                    yield update

    def _update(self) -> AppliedUpdate | None:
        """Collect, update, publish and keep. None where the run was asked to stop while it waited."""
        asked_s = time.monotonic()
        with phase("wait"):
            rollouts = self._collect()
        if rollouts is None:
            return None
        got_s = time.monotonic()
        logged = self._resumed_replay.covers(self._trainer.version)
        if self._began_s is None and not logged:
            self._began_s = got_s - max(sum(rollout.timing.values()) for rollout in rollouts)
            self._began_version = self._trainer.version
        environments = self._hub.environments.kept()
        try:
            with phase("learner"):
                metrics = self._trainer.update(rollouts)
        except NumericsError as error:
            self._keep_last()
            raise NumericsError(f"{error}. {self._last_good()}") from None
        updated_s = time.monotonic()
        with phase("publish"):
            snapshot = self.publish()
        published_s = time.monotonic()
        self._trained_s = 0.0 if self._began_s is None else updated_s - self._began_s
        version = self._trainer.version
        # The actors are at work by now; the time that the rest takes is hidden behind theirs.
        with phase("record"):
            self._digest = self._trainer.digest()
            self._resumed_replay.check(version, self._digest)
            self._keep(version, snapshot, environments)
        seconds = {
            "wait": got_s - asked_s,
            "learner": updated_s - got_s,
            "publish": published_s - updated_s,
            "record": time.monotonic() - published_s,
            "log": self._log_seconds(),
        }
        return AppliedUpdate(version, self.env_steps, self._digest, rollouts, metrics, seconds)

    def _keep(self, version: int, snapshot: bytes, environments: KeptEnvironments | None) -> None:
        """Keep the policy, a checkpoint, and the environments that the checkpoint of the version before needs."""
        due = version % self._settings.log.policy_every == 0 or version == self._settings.updates
        if due and not self._resumed_replay.holds("/policy", version):
            self._outlets.log.write("/policy", snapshot)
        if environments is not None:
            # A resumed run takes a checkpoint with environments only if the log has the update that led to it.
            self._outlets.log.flush(timeout_s=FLUSH_S)
            self._checkpoints.keep_environments(environments)
        if self._settings.log.keep != "everything" and self._is_checkpoint(version - 1):
            self._outlets.log.flush(timeout_s=FLUSH_S)
            self._retention.apply(version - 1)
        if self._is_checkpoint(version):
            self._checkpoints.keep(version, self._trainer.state_arrays())

    def _keep_last(self) -> None:
        """Keep the policy and the state of the last good version, from which no update could be made."""
        version, log = self._trainer.version, self._settings.log
        if version % log.policy_every and not self._resumed_replay.holds("/policy", version):
            arrays = self._trainer.policy_arrays()
            self._outlets.log.write("/policy", make_snapshot(self._checkpoints.run, version, arrays).encode())
        if version and not self._is_checkpoint(version):
            self._checkpoints.keep(version, self._trainer.state_arrays())

    def _last_good(self) -> str:
        return (
            f"Version {self._trainer.version} is the last good one; to continue from it with another batch: "
            f"reskpn train --resume {self._checkpoints.run_dir} --skip-batch"
        )

    def _is_checkpoint(self, version: int) -> bool:
        """True if the state of this version is kept in a file; version 0 follows from the settings."""
        due = version > 0 and version % self._settings.log.checkpoint_every == 0
        return due or version == self._settings.updates

    def _log_seconds(self) -> float:
        """Seconds the log's thread was at work since the last call, beside the loop."""
        before, self._log_busy_s = self._log_busy_s, self._outlets.log.busy_s
        return self._log_busy_s - before

    def _compile(self) -> None:
        """Compile the update while the actors join and compile theirs."""
        began_s = time.monotonic()
        with ThreadPoolExecutor(1, "compile") as pool:
            compiled = pool.submit(self._trainer.compile)
            while not compiled.done():
                parts = [f"compiling the update for {time.monotonic() - began_s:.0f} s", self._hub.waiting_for()]
                self._tick("compiling", "; ".join(part for part in parts if part))
                wait([compiled], TICK_S)
            compiled.result()

    def _collect(self) -> list[Rollout] | None:
        """Wait for the rollouts of this version. Returns None when the run is asked to stop."""
        version = self._trainer.version
        while not self._stop.is_set():
            if (rollouts := self._resumed_replay.logged_rollouts(version) or self._hub.rollouts(TICK_S)) is not None:
                return rollouts
            if (problem := self._hub.policy_problem()) is not None:
                raise NumericsError(f"{problem}: {ADVICE}")
            if self._resumed_replay.fall_back_to_log(version):
                continue
            self._tick("training" if self._trainer.version else "starting", self._hub.waiting_for())
        return None

    def _tick(self, phase: str, text: str) -> None:
        self._hub.announce()
        self._hub.drop_silent()
        self._hub.release_reserved()
        self._show(phase, text)

    # -- recording and showing -----------------------------------------------------------------------------

    def _record(self, update: AppliedUpdate) -> None:
        self._physics |= self._hub.engines()
        self._recorder.count(update)
        if not self._resumed_replay.covers(update.version - 1):
            episodes_logged = self._resumed_replay.holds("/episode", update.version)
            record = self._recorder.write(update, self.steps_per_s, episodes_logged=episodes_logged)
            self._hub.publish_metrics(encode_json(public_update(record)))
        self._show("training", "")

    def _show(self, phase: str, text: str) -> None:
        version, actors = self._trainer.version, self._hub.actors()
        progress = self._recorder.progress(phase, text, version, self.steps_per_s, actors)
        self._outlets.display.show(progress)
        self._hub.publish_progress(progress)
        self.draw_evaluations()
