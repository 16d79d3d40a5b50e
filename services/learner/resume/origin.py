"""The origin of a new run that begins with another run's state: `--from RUN[@VERSION]`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.errors import CodecError, SettingsError
from common.log.reader import LogReader
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import TOPICS, read_updates
from common.wire.messages import digest_arrays
from services.learner.training.checkpoints import list_checkpoints, read_checkpoint
from services.learner.training.trainer import Trainer

OWN = ("version", "key", "discounted")
"""Parts of a state that are the new run's: its count, its random numbers, the returns of its environments so far."""


@dataclass(frozen=True)
class Origin:
    """A version of a run, and the learner state that it was."""

    run: str
    version: int
    arrays: Mapping[str, np.ndarray]

    @property
    def digest(self) -> str:
        return digest_arrays(self.arrays)

    @property
    def record(self) -> dict[str, str]:
        """The origin as the new run's log names it."""
        return {"run": self.run, "version": str(self.version), "state_digest": self.digest}


def read_origin(run_dir: Path, version: int | None = None) -> Origin:
    """The state of a run in its directory at a version; by default the one of its newest checkpoint.

    A version without a checkpoint is computed from the checkpoint before it and the log.

    Raises:
        SettingsError: the run has no such version.
        LogReadError, CheckpointError: log or checkpoint cannot be read.
    """
    recorded = RecordedRun(run_dir)
    kept = {int(path.stem): path for path in list_checkpoints(run_dir)}
    if version is None:
        if not kept:
            raise SettingsError(f"--from {run_dir}: it has no checkpoint; name a version: --from {run_dir}@VERSION")
        version = max(kept)
    trainer = Trainer(recorded.settings)
    below = max((found for found in kept if found <= version), default=0)
    if below:
        trainer.restore(read_checkpoint(kept[below]).arrays)
    elif (initial := recorded.initial_state()) is not None:
        trainer.restore(initial)
    if version > below and below < recorded.first - 1:
        raise SettingsError(
            f"--from {run_dir}@{version}: the log of that run begins at update {recorded.first}, and there is no "
            "checkpoint between that and this version; name a later one"
        )
    if version > below:
        messages = LogReader(run_dir).messages(TOPICS)
        for update in read_updates(messages, run_dir, recorded.settings, after=below):
            trainer.update(update.rollouts)
            if trainer.version == version:
                break
    if trainer.version != version:
        raise SettingsError(
            f"--from {run_dir}@{version}: the log of that run ends at version {trainer.version}; name that one, or one "
            "before it"
        )
    return Origin(recorded.run, version, trainer.state_arrays())


def begin_from(origin: Origin, trainer: Trainer) -> None:
    """Put the origin's state into a new run's trainer, at version 0.

    Raises:
        SettingsError: the settings make a state of another form.
    """
    own = trainer.state_arrays()
    try:
        trainer.restore({**origin.arrays, **{name: own[name] for name in OWN}})
    except CodecError as error:
        raise SettingsError(
            f"--from: the state of {origin.run} does not fit these settings: {error}. Leave task, learner, "
            "algorithm.hidden and what decides the size of h (rkhs.*) as they were"
        ) from None
