"""The plan of a resumption: the restore point, the tail of the log after it, and where every slot goes on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from common.config.settings import RunSettings
from common.log.chain import START, ChainCheck
from common.log.lock import LogLock
from common.log.reader import LogReader
from common.log.repair import describe_repair, repair
from common.log.segments import LOG_DIRECTORY, list_segments
from common.runs.initial_state import read_initial_state
from common.runs.tally import Tally
from common.wire.rollout import RolloutId
from services.learner.resume.logged_run import LoggedRun, LogIndexer, OnRead
from services.learner.resume.restore_point import RestorePoint, choose_restore_point
from services.learner.resume.set_aside import next_batch, set_aside_record
from services.learner.resume.tail import Tail, divergence
from services.learner.scheduling.slots import Start

RESTORED = "parameters, optimiser, expansion and its momentum, normalisers, RNG key and counters"


@dataclass(frozen=True)
class Resumption:
    """The state from which a run goes on.

    Attributes:
        version: of the restore point; 0 for the beginning.
        arrays: the learner's state; None where the settings decide it, at version 0.
        starts: where each slot goes on.
        fresh_starts: where each slot goes on instead, with new environments, if acting does not reproduce the log.
        tail: the content of the log after the restore point.
        log_only_reason: the reason why acting is not even tried for the tail; None where it is.
        episodes: `/episode` records up to the restore point that mean returns depend on; `earlier_episodes`: the number
            of episodes before them.
        logged_environments: (version, slot, generation) of the environment states in the log; `logged_records`: the
            number of records in it by topic.
        set_aside: the `/set_aside` record of a batch that the run goes on without from now on; None for none.
        notes: for a person, line by line.
        chain: digest of the log, from which its writer goes on; `tally`: its totals, None for an empty log.
    """

    run: str
    version: int = 0
    arrays: Mapping[str, np.ndarray] | None = None
    starts: Sequence[Start] = ()
    fresh_starts: Sequence[Start] = ()
    tail: Tail = field(default_factory=Tail)
    log_only_reason: str | None = None
    logged_environments: frozenset[tuple[int, int, int]] = frozenset()
    logged_records: Mapping[str, int] = field(default_factory=dict)
    episodes: Sequence[dict[str, Any]] = ()
    earlier_episodes: int = 0
    set_aside: dict[str, Any] | None = None
    notes: Sequence[str] = ()
    chain: str = START
    tally: Tally | None = None


def plan_resumption(
    settings: RunSettings,
    run_dir: Path,
    lock: LogLock | None = None,
    *,
    skip_batch: bool = False,
    on_read: OnRead | None = None,
) -> Resumption | None:
    """Repair the log in `run_dir`, and choose the newest restore point that it confirms; what that needs is read.

    None where the run was interrupted before its log had begun: there is nothing to go on from, and nothing is lost.
    The caller that goes on to write the log holds its `lock`: another process could otherwise write in between.

    Args:
        skip_batch: set aside the logged batch of the next update.
        on_read: told of the progress of reading.

    Raises:
        SettingsError: the log has no batch to set aside.
        LogReadError, LogWriteError: the log is damaged before its end, or another learner is writing it.
        CheckpointError: the run has neither a checkpoint nor the beginning of its log.
    """
    if not list_segments(run_dir / LOG_DIRECTORY):
        return None
    notes = repair_log(run_dir, lock)
    run = recorded_id(run_dir)
    if not run:
        return None
    log = LogIndexer(run_dir, settings, on_read)
    point, logged = choose_restore_point(run, settings, run_dir, log, notes)
    set_aside = _set_aside(logged, notes) if skip_batch else None
    updates = logged.places(point.version)
    log_only_reason = _log_only_reason(settings, point, logged, updates)
    if point.version == 0 and (initial := read_initial_state(LogReader(run_dir))) is not None:
        point = replace(point, arrays=initial.arrays)
    new = fresh_starts(settings.actors, point, logged)
    notes += [f"warning: {finding}; the run goes on from it all the same" for finding in logged.chain.findings]
    if log.skipped:
        first = logged.segments[0].name
        notes.append(f"the log was read from {first} on; the {log.skipped} files before it are not needed")
    notes.append(_describe(point, len(updates), len(logged.unused)))
    return Resumption(
        run=run,
        version=point.version,
        arrays=point.arrays,
        starts=point.starts if log_only_reason is None else new,
        fresh_starts=new,
        tail=Tail(logged.last, logged.updates_after(point.version), logged.unused, logged.ahead),
        log_only_reason=log_only_reason,
        logged_environments=frozenset(logged.environments),
        logged_records=LogReader(run_dir).counts(),
        episodes=[record for record in logged.episodes if record["version"] <= point.version],
        earlier_episodes=logged.before.earlier_episodes,
        set_aside=set_aside,
        notes=notes,
        chain=logged.chain.digest,
        tally=logged.tally,
    )


def _set_aside(logged: LoggedRun, notes: list[str]) -> dict[str, Any]:
    """Take the next batch out of the rollouts that are left for updates; returns the record of it."""
    batch = next_batch(logged)
    record = set_aside_record(logged.last, batch)
    ids = {rollout.id for rollout in batch}
    logged.unused = [rollout for rollout in logged.unused if rollout.id not in ids]
    logged.set_aside.setdefault(logged.last, set()).update(ids)
    notes.append(f"set aside: the {len(batch)} rollouts for the update after {logged.last}; others replace them")
    return record


def recorded_id(run_dir: Path) -> str:
    """The id of the run whose log is in `run_dir`; "" where the log has not begun."""
    if not list_segments(run_dir / LOG_DIRECTORY):
        return ""
    return LogReader(run_dir).metadata().get("run", {}).get("run", "")


def chain_of(run_dir: Path) -> str:
    """Digest of a log that nothing else is read of; that of an empty one where there is none."""
    chain = ChainCheck()
    if list_segments(run_dir / LOG_DIRECTORY):
        for _ in LogReader(run_dir).messages(chain=chain):
            pass
    return chain.digest


def repair_log(run_dir: Path, lock: LogLock | None = None) -> list[str]:
    """Make the torn segments of the log whole; returns a line for each."""
    return describe_repair(repair(run_dir, lock))


def _log_only_reason(
    settings: RunSettings, point: RestorePoint, logged: LoggedRun, updates: Sequence[tuple[RolloutId, ...]]
) -> str | None:
    """The reason why the tail's updates are made from its rollouts, without acting; None where actors act."""
    if settings.mode == "async":
        return "in async mode what actors make depends on the timing, and cannot be made again"
    if (skipped := [version for version in logged.set_aside if version >= point.version]) and point.starts:
        # The same environments would make the same rollouts, which were of no use.
        return f"the batch that would have updated version {max(skipped)} was set aside"
    if logged.last >= settings.updates:
        return "no environments are needed any more" if updates else None
    unused = [
        [rollout.id for rollout in logged.unused if rollout.policy_version == version]
        for version in (logged.last, logged.last + 1)
    ]
    return divergence(point.starts, updates, unused, point.version) if updates or logged.unused else None


def fresh_starts(slots: int, point: RestorePoint, logged: LoggedRun) -> list[Start]:
    """New environments for every slot, of generations that the log does not have."""
    next_free = [start.generation + 1 for start in point.starts] or [0] * slots
    places = [place for entry in logged.updates.values() for place in entry.places]
    unused = [*(rollout.id for rollout in logged.unused), *chain.from_iterable(logged.set_aside.values())]
    for slot, generation in [*logged.before.generations.items(), *(place[:2] for place in [*places, *unused])]:
        next_free[slot] = max(next_free[slot], generation + 1)
    return [Start(generation) for generation in next_free]


def _describe(point: RestorePoint, updates: int, unused: int) -> str:
    environments = sum(start.environment is not None for start in point.starts)
    state = f"{RESTORED} of version {point.version}" if point.version else "from the beginning"
    return (
        f"resumed: {state}; environments of {environments} slots; a tail of {updates} updates and "
        f"{unused} rollouts not yet used"
    )
