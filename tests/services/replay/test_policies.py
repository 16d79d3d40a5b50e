"""Policies of a recorded run by version."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recorded_runs import UPDATES, Recording, batch, write_log

from common.errors import SettingsError
from common.runs.recorded_run import RecordedRun, open_run
from services.learner.training.trainer import Trainer
from services.replay.policies import recorded_policy


@pytest.fixture
def run(recording: Recording, tmp_path: Path) -> RecordedRun:
    return open_run(write_log(tmp_path / "x", recording.messages))


class Uncompiled:
    """The session's trainer, put back to the beginning; compiling it once more would only take time."""

    def __init__(self, trainer: Trainer, recording: Recording) -> None:
        trainer.restore(recording.start)
        self._trainer = trainer
        self.update, self.digest, self.policy_arrays = trainer.update, trainer.digest, trainer.policy_arrays

    def compile(self) -> None:
        """Compiled already."""


def test_a_policy_of_the_log(run: RecordedRun) -> None:
    """The newest by default; no learner is made for it."""
    for version in (None, UPDATES):
        found = recorded_policy(run, version, lambda: pytest.fail("not needed"), lambda version: None)
        assert (found.version, found.recomputed, found.exact) == (UPDATES, False, True)
        (snapshot,) = run.policies()
        assert {name: array.tobytes() for name, array in found.arrays.items()} == {
            name: array.tobytes() for name, array in snapshot.arrays.items()
        }


def test_any_other_version_is_recomputed(run: RecordedRun, trainer: Trainer, recording: Recording) -> None:
    """From the log, to the very policy that the learner had then; the newest one's is not that of version 2."""
    trainer.restore(recording.start)
    trainer.update(batch(1))
    trainer.update(batch(2))
    expected = trainer.policy_arrays()
    seen: list[int] = []
    found = recorded_policy(run, 2, lambda: Uncompiled(trainer, recording), seen.append)  # type: ignore[arg-type,return-value]
    assert (found.version, found.recomputed, found.exact, seen) == (2, True, True, [1, 2])
    assert all(np.array_equal(found.arrays[name], expected[name]) for name in expected)


def test_the_policy_before_training(run: RecordedRun, trainer: Trainer, recording: Recording) -> None:
    """Version 0 needs no update."""
    found = recorded_policy(run, 0, lambda: Uncompiled(trainer, recording), lambda version: pytest.fail("none"))  # type: ignore[arg-type,return-value]
    trainer.restore(recording.start)
    expected = trainer.policy_arrays()
    assert (found.version, found.recomputed) == (0, True)
    assert all(np.array_equal(found.arrays[name], expected[name]) for name in expected)


@pytest.mark.parametrize("version", [-1, UPDATES + 1])
def test_versions_that_there_are_not(run: RecordedRun, version: int) -> None:
    """With those that there are."""
    with pytest.raises(SettingsError, match=f"--version {version}: the log of .* has versions 0 to {UPDATES}"):
        recorded_policy(run, version, lambda: pytest.fail("not needed"), lambda version: None)
