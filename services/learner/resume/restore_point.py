"""The restore point of a resumed run: the newest checkpoint that its log confirms, with its environments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.config.settings import RunSettings
from common.errors import CheckpointError, CodecError
from common.wire.messages import Snapshot
from services.learner.resume.environment_soundness import unsound_environments
from services.learner.resume.logged_run import LoggedRun
from services.learner.scheduling.slots import Start
from services.learner.training.checkpoints import list_checkpoints, quarantine, read_checkpoint, read_environments


@dataclass(frozen=True)
class RestorePoint:
    """A version that the run can be restored to; 0, without arrays, is the beginning, which the settings decide.

    `starts` is empty where no slot goes on: after the last update, and in async mode.
    """

    version: int
    arrays: Mapping[str, np.ndarray] | None
    starts: Sequence[Start]


class _Incomplete(Exception):
    """A sound checkpoint that was written too shortly before the interruption."""


def choose_restore_point(
    run: str, settings: RunSettings, run_dir: Path, logged: LoggedRun, notes: list[str]
) -> RestorePoint:
    """The newest checkpoint that is whole, of this run and complete; else the beginning.

    The reason why a newer one is not taken is added to `notes`; a damaged one is quarantined.

    Raises:
        CheckpointError: there is neither a checkpoint nor the beginning of the log.
    """
    for path in reversed(list_checkpoints(run_dir)):
        try:
            return _restore(path, run, settings, logged)
        except CheckpointError as error:
            notes.append(f"warning: {error}")
            quarantine(path)
        except _Incomplete as reason:
            notes.append(f"not from checkpoint {path.name}: {reason}")
    if logged.updates and min(logged.updates) > 1:
        raise CheckpointError(
            f"{run_dir} has no checkpoint to go on from, and its log begins at update {min(logged.updates)}; "
            "restore a checkpoint or the log's first files from a copy"
        )
    # An actor lost before its first rollout may have advanced a generation; only the log can tell.
    return RestorePoint(0, None, [Start(0) for _ in range(settings.actors)])


def _restore(path: Path, run: str, settings: RunSettings, logged: LoggedRun) -> RestorePoint:
    """The restore point of a checkpoint. CheckpointError: it contradicts the run; _Incomplete: it came too late."""
    state = read_checkpoint(path)
    if state.run != run:
        raise CheckpointError(f"{path} is of the run {state.run!r}, not of {run!r}")
    entry = logged.updates.get(state.version)
    if entry is None:
        raise _Incomplete(f"the log ends at update {logged.last}, before it")
    if entry.digest != state.digest:
        raise CheckpointError(
            f"{path} has digest {state.digest}, its update in the log {entry.digest}: it is not of this log"
        )
    if state.version >= settings.updates or settings.mode == "async":
        return RestorePoint(state.version, state.arrays, [])
    starts = _starts(path, state, settings.actors)
    if unsound := unsound_environments(path):
        raise _Incomplete(f"{unsound}, so actors would end with them")
    return RestorePoint(state.version, state.arrays, starts)


def _starts(path: Path, state: Snapshot, slots: int) -> list[Start]:
    kept = read_environments(path)
    if kept is None:
        raise _Incomplete("the actors had not handed in their environments")
    if (kept.run, kept.version, len(kept.given)) != (state.run, state.version, slots):
        raise CheckpointError(f"the environments beside {path} are not of it")
    try:
        return [
            Start.of(kept.states[slot]) if slot in kept.states else Start(kept.given[slot]) for slot in range(slots)
        ]
    except CodecError as error:
        raise CheckpointError(f"the environments beside {path} are damaged: {error}") from None
