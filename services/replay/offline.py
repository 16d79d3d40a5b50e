"""Offline training: a second learner on the rollouts of a recorded run, in their order, without an environment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.runs.directory import SUMMARY, TENSORBOARD, prepare_run_dir, write_json
from common.runs.recorded_updates import RecordedUpdate
from common.wire.messages import Snapshot, digest_arrays
from services.learner.reporting.scalars import Scalars
from services.learner.training.checkpoints import write_checkpoint
from services.learner.training.trainer import Trainer

FIXED = ("task", "actors", "num_envs", "num_steps", "episode_length", "initial_states")
"""Settings that the recorded rollouts depend on; another learner cannot choose them."""

OnUpdate = Callable[[int, dict[str, float]], None]
"""(version, its metrics)."""


def require_same_rollouts(recorded: RunSettings, settings: RunSettings) -> None:
    """Raise SettingsError unless these settings can use the rollouts of the recorded run."""
    for name in FIXED:
        old, new = getattr(recorded, name), getattr(settings, name)
        if old != new:
            raise SettingsError(
                f"{name} is {new!r}, but the recorded rollouts were made with {old!r}; leave it out, for it cannot be "
                "changed afterwards"
            )
    if bool(recorded.branches) != bool(settings.branches):
        made, needs = ("with", "none") if recorded.branches else ("without", "them")
        raise SettingsError(
            f"the recorded rollouts were made {made} mirrored steps, and learner {settings.learner} with rkhs.estimate "
            f"{settings.rkhs.estimate} takes {needs}; choose a learner with h and rkhs.estimate "
            f"{recorded.rkhs.estimate if recorded.branches else 'score'}"
        )


def train_offline(
    run: str, settings: RunSettings, trainer: Trainer, updates: Iterator[RecordedUpdate], on_update: OnUpdate
) -> Path:
    """Train another learner with the recorded updates; returns the run directory that it leaves.

    It holds `settings.json`, curves by environment step, the last state as a checkpoint, and `summary.json`.

    Args:
        run: name of the recorded run.
        trainer: compiled, of `settings`, before its first update.

    Raises:
        SettingsError: the run directory holds another run, or cannot be written.
        NumericsError: an update is not finite.
    """
    run_dir = prepare_run_dir(settings)
    scalars = Scalars(run_dir / TENSORBOARD)
    try:
        metrics: dict[str, float] = {}
        for update in updates:
            metrics = trainer.update(update.rollouts)
            scalars.add(update.env_steps, metrics)
            on_update(trainer.version, metrics)
    finally:
        scalars.close()
    arrays = trainer.state_arrays()
    digest = digest_arrays(arrays)
    write_checkpoint(run_dir, Snapshot(run, trainer.version, digest, arrays))
    write_json(run_dir / SUMMARY, _summary(run, settings, trainer.version, digest, metrics))
    return run_dir


def _summary(run: str, settings: RunSettings, version: int, digest: str, metrics: dict[str, float]) -> dict[str, Any]:
    return {
        "experience_of": run,
        "task": settings.task,
        "learner": settings.learner,
        "seed": settings.seed,
        "updates": version,
        "total_steps": version * settings.batch_size,
        "metrics": metrics,
        "state_digest": digest,
    }
