"""What `--resume` promises: a run that was killed ends in the very state it would have ended in."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.chaos.interruptions import (
    OPTIONS,
    UPDATES,
    Apart,
    Processes,
    audited,
    train_until,
    updates_seen,
    wait_for,
)

pytestmark = pytest.mark.timeout(400)  # three processes load and compile at every start


def test_all_processes_killed(started: Processes, tmp_path: Path, undisturbed: list[str]) -> None:
    """Twice: between two checkpoints, and when a checkpoint has just appeared, before its environments are there."""
    run_dir = tmp_path / "run"
    train_until(started, run_dir, OPTIONS, lambda: updates_seen(run_dir) >= 17)

    resume = ["--resume", str(run_dir)]
    again = started.start("train", *resume)
    wait_for(lambda: (run_dir / "checkpoints" / "00000040.ckpt").exists(), [again])
    again.kill()
    assert "parameters, optimiser, expansion and its momentum, normalisers" in again.words.read_text()

    printed = started.start("train", *resume).end()
    assert "environments of 2 slots; a tail of" in printed
    assert audited(run_dir, UPDATES) == undisturbed
    summary = json.loads((run_dir / "summary.json").read_text())
    assert (summary["complete"], summary["state_digest"]) == (True, undisturbed[-1])
    # There is nothing left to do, and that is no error.
    assert "this run has finished, with 60 updates" in started.start("train", *resume).end()


def test_the_learner_alone_killed(started: Processes, tmp_path: Path, undisturbed: list[str]) -> None:
    """Its actors stay, join the next learner on the same endpoint, and go on with the environments it gives them."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, OPTIONS)
    apart.kill_learner(lambda: updates_seen(run_dir) >= 23)
    apart.resume_learner()
    assert "acting again does not give" not in apart.end()
    assert audited(run_dir, UPDATES) == undisturbed
