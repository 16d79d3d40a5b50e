"""What `--resume` promises: a run that was killed ends in the very state it would have ended in."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.interruptions import (
    Apart,
    Processes,
    audited,
    processes,
    small_options,
    train_until,
    updates_seen,
    wait_for,
)

UPDATES = 60
OPTIONS = small_options(UPDATES)
pytestmark = pytest.mark.timeout(400)  # three processes load and compile at every start


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as made:
        yield made


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The digests of the run that nobody disturbs."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    with processes(folder) as made:
        made.start("train", *OPTIONS, "--run-dir", folder / "run").end()
    return audited(folder / "run", UPDATES)


def test_all_processes_killed(started: Processes, tmp_path: Path, uninterrupted: list[str]) -> None:
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
    assert audited(run_dir, UPDATES) == uninterrupted
    summary = json.loads((run_dir / "summary.json").read_text())
    assert (summary["complete"], summary["state_digest"]) == (True, uninterrupted[-1])
    # There is nothing left to do, and that is no error.
    assert "this run has finished, with 60 updates" in started.start("train", *resume).end()


def test_the_learner_alone_killed(started: Processes, tmp_path: Path, uninterrupted: list[str]) -> None:
    """Its actors stay, join the next learner on the same endpoint, and go on with the environments it gives them."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, OPTIONS)
    apart.kill_learner(lambda: updates_seen(run_dir) >= 23)
    apart.resume_learner()
    assert "acting again does not give" not in apart.end()
    assert audited(run_dir, UPDATES) == uninterrupted
