"""Going on with an interrupted run: which checkpoint, what of the log comes after it, and where every slot goes on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from common.config.settings import RunSettings
from common.errors import CheckpointError, CodecError, LogReadError
from common.log.reader import LogReader
from common.log.repair import repair
from common.log.segments import LOG_DIRECTORY, list_segments
from common.wire.messages import Snapshot
from services.learner.resume.logged_run import LoggedRun, read_logged_run
from services.learner.resume.tail import Tail, divergence
from services.learner.scheduling.slots import Place, Start
from services.learner.training.checkpoints import list_checkpoints, put_aside, read_checkpoint, read_environments

RESTORED = "parameters, optimiser, expansion and its momentum, normalisers, RNG key and counters"


@dataclass(frozen=True)
class Resumption:
    """What a run goes on from.

    Attributes:
        version: of the checkpoint; 0 for the beginning.
        arrays: the learner's state; None at version 0, where the settings decide it.
        starts: where each slot goes on.
        afresh: where each slot goes on instead, with new environments, if acting again does not give what is logged.
        tail: what the log holds after the checkpoint.
        by_log: why acting again is not even tried; None where it is.
        episodes: `/episode` records up to the checkpoint.
        notes: what a person should know, line by line.
    """

    run: str
    version: int = 0
    arrays: Mapping[str, np.ndarray] | None = None
    starts: Sequence[Start] = ()
    afresh: Sequence[Start] = ()
    tail: Tail = field(default_factory=Tail)
    by_log: str | None = None
    logged_environments: frozenset[tuple[int, int, int]] = frozenset()
    episodes: Sequence[dict[str, Any]] = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Found:
    """A checkpoint that the run can go on from. `starts` is empty where no slot goes on: at the end, in async mode."""

    version: int
    arrays: Mapping[str, np.ndarray] | None
    starts: Sequence[Start]


def resume_run(settings: RunSettings, run_dir: Path) -> Resumption | None:
    """Repair the log in `run_dir`, read it, and pick the newest checkpoint that it goes on from.

    None where the run was interrupted before its log had begun: there is nothing to go on from, and nothing is lost.

    Raises:
        LogReadError, LogWriteError: the log is damaged before its end, or another learner is writing it.
        CheckpointError: the run has neither a checkpoint nor the beginning of its log.
    """
    if not list_segments(run_dir / LOG_DIRECTORY):
        return None
    notes = repair_log(run_dir)
    run = LogReader(run_dir).metadata().get("run", {}).get("run")
    if run is None:
        return None
    logged = _read(run_dir, settings)
    found = pick(run, settings, run_dir, logged, notes)
    updates = logged.places(found.version)
    by_log = _by_log(settings, found, logged, updates)
    afresh = _afresh(settings.actors, found, logged)
    notes.append(_restored(found, len(updates), len(logged.unused)))
    return Resumption(
        run=run,
        version=found.version,
        arrays=found.arrays,
        starts=found.starts if by_log is None else afresh,
        afresh=afresh,
        tail=Tail(logged.last, logged.updates_after(found.version), logged.unused, logged.ahead),
        by_log=by_log,
        logged_environments=frozenset(logged.environments),
        episodes=[record for record in logged.episodes if record["version"] <= found.version],
        notes=notes,
    )


def _by_log(settings: RunSettings, found: Found, logged: LoggedRun, updates: Sequence[tuple[Place, ...]]) -> str | None:
    """Why the log's updates after the checkpoint are made from its rollouts, without acting again; None where not."""
    if settings.mode == "async":
        return "in async mode what actors make depends on the timing, and cannot be made again"
    if logged.last >= settings.updates:
        return "no environments are needed any more" if updates else None
    unused = [
        [rollout.place for rollout in logged.unused if rollout.policy_version == version]
        for version in (logged.last, logged.last + 1)
    ]
    return divergence(found.starts, updates, unused, found.version) if updates or logged.unused else None


def _read(run_dir: Path, settings: RunSettings) -> LoggedRun:
    try:
        return read_logged_run(run_dir, settings.actors, settings.staleness)
    except (CodecError, KeyError) as error:
        raise LogReadError(
            f"the log in {run_dir} cannot be used: {error}; resume it with the release that wrote it"
        ) from None


def repair_log(run_dir: Path) -> list[str]:
    """Make the torn segments of the log whole; what was done, line by line."""
    notes = []
    for segment in repair(run_dir).segments:
        kept = f", {segment.dropped_bytes:,} bytes of an incomplete record kept aside in {segment.torn_path}"
        notes.append(
            f"repaired {segment.path}: {segment.messages} messages are whole{kept if segment.torn_path else ''}"
        )
    return notes


def pick(run: str, settings: RunSettings, run_dir: Path, logged: LoggedRun, notes: list[str]) -> Found:
    """The newest checkpoint that is whole, of this run and complete; else the beginning. Says why others are not."""
    for path in reversed(list_checkpoints(run_dir)):
        try:
            return _usable(path, run, settings, logged)
        except CheckpointError as error:
            notes.append(f"warning: {error}")
            put_aside(path)
        except _NotYet as reason:
            notes.append(f"not from checkpoint {path.name}: {reason}")
    if logged.updates and min(logged.updates) > 1:
        raise CheckpointError(
            f"{run_dir} has no checkpoint to go on from, and its log begins at update {min(logged.updates)}; "
            "restore a checkpoint or the log's first files from a copy"
        )
    # What a death before the first rollout changed is in the generations of the log, if anywhere.
    return Found(0, None, [Start(0) for _ in range(settings.actors)])


class _NotYet(Exception):
    """A checkpoint that is good, but was written too shortly before the end."""


def _usable(path: Path, run: str, settings: RunSettings, logged: LoggedRun) -> Found:
    """What a checkpoint gives. CheckpointError where it contradicts the run, _NotYet where it is not complete."""
    state = read_checkpoint(path)
    if state.run != run:
        raise CheckpointError(f"{path} is of the run {state.run!r}, not of {run!r}")
    entry = logged.updates.get(state.version)
    if entry is None:
        raise _NotYet(f"the log ends at update {logged.last}, before it")
    if entry.digest != state.digest:
        raise CheckpointError(
            f"{path} has digest {state.digest}, its update in the log {entry.digest}: it is not of this log"
        )
    if state.version >= settings.updates or settings.mode == "async":
        return Found(state.version, state.arrays, [])
    return Found(state.version, state.arrays, _starts(path, state, settings.actors))


def _starts(path: Path, state: Snapshot, slots: int) -> list[Start]:
    kept = read_environments(path)
    if kept is None:
        raise _NotYet("the actors had not handed in their environments")
    if (kept.run, kept.version, len(kept.given)) != (state.run, state.version, slots):
        raise CheckpointError(f"the environments beside {path} are not of it")
    try:
        return [
            Start.of(kept.states[slot]) if slot in kept.states else Start(kept.given[slot]) for slot in range(slots)
        ]
    except CodecError as error:
        raise CheckpointError(f"the environments beside {path} are damaged: {error}") from None


def _afresh(slots: int, found: Found, logged: LoggedRun) -> list[Start]:
    """New environments for every slot, of generations that the log does not have."""
    next_free = [start.generation + 1 for start in found.starts] or [0] * slots
    places = [place for entry in logged.updates.values() for place in entry.places]
    for slot, generation, _ in [*places, *(rollout.place for rollout in logged.unused)]:
        next_free[slot] = max(next_free[slot], generation + 1)
    return [Start(generation) for generation in next_free]


def _restored(found: Found, updates: int, unused: int) -> str:
    environments = sum(start.environment is not None for start in found.starts)
    state = f"{RESTORED} of version {found.version}" if found.version else "from the beginning"
    return (
        f"resumed: {state}; environments of {environments} slots; a tail of {updates} updates and "
        f"{unused} rollouts not yet used"
    )
