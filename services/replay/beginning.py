"""The state that a recorded run is re-executed from: its first, or that of a checkpoint where the log has lost more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.errors import CheckpointError, LogReadError
from common.log.segments import LOG_DIRECTORY
from common.runs.recorded_run import RecordedRun
from services.learner.training.checkpoints import list_checkpoints, read_checkpoint


@dataclass(frozen=True)
class ReplayBeginning:
    """The version and the state before the first update that is made again.

    Attributes:
        arrays: None where the settings decide the state.
        digest: of a checkpoint's state; "" for the beginning of the run.
        path: of that checkpoint.
    """

    version: int = 0
    arrays: Mapping[str, np.ndarray] | None = None
    digest: str = ""
    path: Path | None = None


def read_beginning(run: RecordedRun) -> ReplayBeginning:
    """The beginning of the run; where its first segments were removed, the oldest checkpoint that the log goes on from.

    Raises:
        LogReadError: there is no such checkpoint, or the log is damaged.
    """
    if run.whole:
        return ReplayBeginning(arrays=run.initial_state())
    for path in list_checkpoints(directory_of(run)):
        if not run.first - 1 <= int(path.stem) <= run.newest:
            continue
        try:
            state = read_checkpoint(path)
        except CheckpointError:
            continue  # a later one will do
        if state.run == run.run:
            return ReplayBeginning(state.version, state.arrays, state.digest, path)
    raise LogReadError(
        f"{run.path}: {describe_removed(run)}, and beside the log is no checkpoint from which the others could be made "
        "again; restore one, or the removed segments, from a copy"
    )


def directory_of(run: RecordedRun) -> Path:
    """The run directory of a recorded run that was opened by it or by its log directory."""
    return run.path.parent if run.path.name == LOG_DIRECTORY else run.path


def describe_removed(run: RecordedRun) -> str:
    """The part of the log that was removed, as the beginning of a sentence; empty for a whole log."""
    if run.whole:
        return ""
    keep = run.newest_settings().log.keep
    how = "removed" if keep == "everything" else f"removed by retention (log.keep {keep})"
    return f"the first {run.before.version} updates were {how}"
