"""What is slow is waited for, and what is full stops a run that can go on later."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.chaos.interruptions import OPTIONS, UPDATES, Apart, Processes, audited

pytestmark = pytest.mark.timeout(400)

COLLECT = "services.actor.collector:Collector.collect"
COMMIT = "common.log.segment_writer:SegmentWriter.commit"
SYNC = "common.log.segment_writer:SegmentWriter.sync"
SMALL_KB = 350
"""Too small for the whole run, large enough for its first checkpoints."""


def test_a_slow_actor(started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]) -> None:
    """A slow actor is waited for, and the learner says so: the run ends in the same state, nobody is given up."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, OPTIONS, actor_faults=([f"slow 0.02 {COLLECT}", f"hang 5 {COLLECT} 20"], []))
    report = apart.report_once(lambda report: re.search(r"slot \d collecting [2-5] s", report.waiting_for))
    assert report.waiting_for.startswith("waiting for 1 of 2 rollouts: slot ")
    assert (report.totals.lost, report.totals.refused) == (0, 0)
    apart.end()
    assert audited(run_dir, UPDATES) == undisturbed
    found(f"'{report.waiting_for}'; {UPDATES} of {UPDATES} digests equal")


def test_a_stalled_disk(
    started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """A disk that stalls for 10 s, and again in a sync: actors are answered busy, nothing is dropped, the learner says
    what it waits for, and the run ends in the same state."""
    run_dir, impatient = tmp_path / "run", tmp_path / "impatient.yaml"
    impatient.write_text("transport:\n  push_timeout_s: 1.0\n")
    apart = Apart(
        started,
        run_dir,
        OPTIONS,
        learner_faults=[f"hang 10 {COMMIT} 40", f"hang 3 {SYNC} 2"],
        # These ask again after a second without an answer.
        actor_words=["--config", impatient],
    )
    report = apart.report_once(lambda report: report.totals.busy > 0)
    assert "being written to the log" in report.waiting_for
    assert (report.totals.lost, report.totals.refused) == (0, 0)
    assert apart.end().count("fault: hangs") == 2
    assert audited(run_dir, UPDATES) == undisturbed
    found(f"'{report.waiting_for}', answered busy; {UPDATES} of {UPDATES} digests equal")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of `SMALL_KB`; skipped where nobody may mount one."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SMALL_KB}k", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("a small disk cannot be mounted here; `test_a_limit_on_files` does without")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_full_disk(
    started: Processes, small_disk: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """A full disk stops the run with a sentence; with room made and resumed it ends in the same state."""
    run_dir = small_disk / "run"
    apart = Apart(started, run_dir, OPTIONS)
    printed = apart.learner.end(5)
    assert "No space left on device" in printed
    assert "Traceback" not in printed
    done = len(audited(run_dir, None))
    subprocess.run(["mount", "-o", "remount,size=64m", str(small_disk)], check=True)
    goes_on(apart)
    assert audited(run_dir, UPDATES) == undisturbed
    found(f"stopped with a sentence after update {done}, resumed: {UPDATES} of {UPDATES} digests equal")


def test_a_limit_on_files(
    started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """A limit on the size of files (ulimit -f) stops the run with a sentence; without it, resumed, it ends in the same
    state."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, OPTIONS, learner_faults=["small 200000"])
    printed = apart.learner.end(5)
    assert "raise the limit on file size (ulimit -f)" in printed
    assert "Traceback" not in printed
    done = len(audited(run_dir, None))
    goes_on(apart)
    assert audited(run_dir, UPDATES) == undisturbed
    found(f"stopped with a sentence after update {done}, resumed: {UPDATES} of {UPDATES} digests equal")


def goes_on(apart: Apart) -> None:
    """As on another day, with actors of its own: those of before were sent home, or wait for it."""
    apart.lose_actors()
    apart.resume_learner()
    for _ in range(2):
        apart.add_actor()
    apart.end()
