"""Records applied updates in the log and the curves, and keeps the figures that are shown of the run."""

from __future__ import annotations

from typing import Any

from common.config.settings import RunSettings
from common.wire.report import Progress
from services.learner.reporting.curves import points_of_update
from services.learner.reporting.outlets import Outlets
from services.learner.reporting.statistics import Episodes, TrainingReturn, step_reward
from services.learner.reporting.updates import AppliedUpdate


class UpdateRecorder:
    """One run's figures, from its updates in order.

    Args:
        returns: the training returns of the run so far.
    """

    def __init__(self, settings: RunSettings, outlets: Outlets, returns: TrainingReturn) -> None:
        self.returns = returns
        self._settings = settings
        self._outlets = outlets
        self._centres = 0
        self._simulations_diverged = 0
        self._staleness = 0.0
        self._step_reward: float | None = None

    def count(self, update: AppliedUpdate) -> None:
        """Take in the figures of an update."""
        self.returns.add(update.version, Episodes.of(update.rollouts))
        self._step_reward = step_reward(update.rollouts)
        self._simulations_diverged += update.diverged
        self._centres = round(update.metrics.get("rkhs/centres", 0))
        self._staleness = update.staleness["mean"]

    def write(self, update: AppliedUpdate, steps_per_s: float | None, *, episodes_logged: bool) -> dict[str, Any]:
        """Write the records and the points of the update that was counted last; returns its `/update` record.

        `episodes_logged`: the log has its `/episode` record already.
        """
        ended = Episodes.of(update.rollouts).record(update.version)
        if ended is not None and not episodes_logged:
            self._outlets.log.write("/episode", ended)
        shown = {"return": self.returns.newest, "step_reward": self._step_reward, "steps_per_s": steps_per_s}
        record = update.record(shown)
        self._outlets.log.write("/update", record)
        self._outlets.scalars.add(update.env_steps, points_of_update(record))
        self._outlets.scalars.flush()
        return record

    def progress(self, phase: str, text: str, version: int, steps_per_s: float | None, actors: int) -> Progress:
        """The run at this moment; `text` says what it waits for."""
        return Progress(
            phase=phase,
            text=text,
            version=version,
            updates=self._settings.updates,
            env_steps=version * self._settings.batch_size,
            total_steps=self._settings.updates * self._settings.batch_size,
            steps_per_s=steps_per_s,
            train_return=self.returns.newest,
            step_reward=self._step_reward,
            staleness=self._staleness,
            diverged=self._simulations_diverged,
            centres=self._centres,
            capacity=self._settings.capacity,
            actors=actors,
            slots=self._settings.actors,
        )
