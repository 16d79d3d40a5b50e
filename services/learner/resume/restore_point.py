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
from services.learner.resume.logged_run import LoggedRun, LogIndexer
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
    run: str, settings: RunSettings, run_dir: Path, log: LogIndexer, notes: list[str]
) -> tuple[RestorePoint, LoggedRun]:
    """The newest checkpoint that is whole, of this run and complete, else the beginning; and the log as it needs it.

    The reason why a newer one is not taken is added to `notes`; a damaged one is quarantined.

    Raises:
        CheckpointError: there is neither a checkpoint nor the beginning of the log.
        LogReadError: the log is damaged.
    """
    for path in reversed(list_checkpoints(run_dir)):
        try:
            state = _read_state(path, run)
            logged = log.since(state.version)
            return _restore(path, state, settings, logged), logged
        except CheckpointError as error:
            notes.append(f"warning: {error}")
            quarantine(path)
        except _Incomplete as reason:
            notes.append(f"not from checkpoint {path.name}: {reason}")
    logged = log.since(0)
    if logged.before.version or (logged.updates and min(logged.updates) > 1):
        raise CheckpointError(
            f"{run_dir} has no checkpoint to go on from, and its log begins at update "
            f"{min(logged.updates, default=logged.before.version + 1)}; "
            "restore a checkpoint or the log's first files from a copy"
        )
    # An actor lost before its first rollout may have advanced a generation; only the log can tell.
    return RestorePoint(0, None, [Start(0) for _ in range(settings.actors)]), logged


def _read_state(path: Path, run: str) -> Snapshot:
    state = read_checkpoint(path)
    if state.run != run:
        raise CheckpointError(f"{path} is of the run {state.run!r}, not of {run!r}")
    return state


def _restore(path: Path, state: Snapshot, settings: RunSettings, logged: LoggedRun) -> RestorePoint:
    """The restore point of a checkpoint. CheckpointError: it contradicts the run; _Incomplete: it came too late."""
    entry = logged.updates.get(state.version)
    if entry is None and state.version <= logged.before.version:
        raise _Incomplete(f"the log begins after update {logged.before.version}: what follows it was removed")
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
