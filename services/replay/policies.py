"""Policies of a recorded run: those in its log, and any other version recomputed from the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.errors import SettingsError
from common.runs.read_ahead import read_ahead
from common.runs.recorded_run import RecordedRun
from common.wire.messages import Snapshot
from services.learner.training.trainer import Trainer
from services.replay.beginning import describe_removed, read_beginning


@dataclass(frozen=True)
class RecordedPolicy:
    """The policy of a version as arrays by path.

    `recomputed`: it was not in the log and was computed from it; `exact`: to the state that the run recorded.
    """

    version: int
    arrays: dict[str, np.ndarray]
    recomputed: bool = False
    exact: bool = True


def recorded_policy(
    run: RecordedRun,
    version: int | None,
    make_trainer: Callable[[], Trainer],
    on_update: Callable[[int], None],
) -> RecordedPolicy:
    """The policy of a version of a recorded run; of its newest version for None.

    Args:
        make_trainer: the learner before its first update; made only if the log does not hold the policy.
        on_update: called with each version that is recomputed.

    Raises:
        SettingsError: the run has no such version.
        LogReadError: the log cannot be read.
        NumericsError: an update that is recomputed is not finite.
    """
    newest = run.newest
    wanted = newest if version is None else version
    if not 0 <= wanted <= newest:
        raise SettingsError(f"--version {wanted}: the log of {run.run} has versions 0 to {newest}; give one of them")
    for snapshot in run.policies():
        if snapshot.version == wanted:
            return RecordedPolicy(wanted, snapshot.arrays)
    return _recomputed(run, wanted, make_trainer(), on_update)


def newest_held_policy(run: RecordedRun) -> RecordedPolicy | None:
    """The newest policy that the log holds; None if it holds none. LogReadError as `recorded_policy`."""
    newest: Snapshot | None = None
    for snapshot in run.policies():
        newest = snapshot
    return None if newest is None else RecordedPolicy(newest.version, newest.arrays)


def _recomputed(run: RecordedRun, version: int, trainer: Trainer, on_update: Callable[[int], None]) -> RecordedPolicy:
    exact = True
    begins = read_beginning(run)
    if version < begins.version:
        raise SettingsError(
            f"--version {version}: {describe_removed(run)}; give one that is in the log, or {begins.version} or later"
        )
    if begins.arrays is not None:
        trainer.restore(begins.arrays)
    if version > begins.version:
        trainer.compile()
        with read_ahead(run.updates(after=begins.version, until=version)) as updates:
            for update in updates:
                trainer.update(update.rollouts)
                on_update(update.version)
        exact = trainer.digest() == update.state_digest
    return RecordedPolicy(version, trainer.policy_arrays(), recomputed=True, exact=exact)
