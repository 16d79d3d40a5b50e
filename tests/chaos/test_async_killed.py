"""Async mode and `kill -9`: what actors made depended on the timing, but nothing of it is lost."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.chaos.interruptions import (
    LONGEST_DELAY_S,
    SEED,
    Apart,
    Processes,
    audited,
    events,
    small_options,
    updates_seen,
    verified,
)

pytestmark = pytest.mark.timeout(400)
UPDATES = 120
OPTIONS = [*small_options(UPDATES), "--mode", "async", "--max-staleness", "2"]


def test_killed_twice_in_async_mode(started: Processes, tmp_path: Path, found: Callable[[str], None]) -> None:
    """In async mode, too, what was acknowledged is in the log once and used once, and every state follows from it."""
    run_dir, draw = tmp_path / "run", random.Random(f"{SEED}-async")
    apart = Apart(started, run_dir, OPTIONS)
    for updates in (draw.randrange(10, 50), draw.randrange(60, 100)):
        apart.kill_learner(lambda updates=updates: updates_seen(run_dir) >= updates, draw.uniform(0, LONGEST_DELAY_S))
        before = audited(run_dir, None, waiting_updates=4)
        assert len(before) >= updates
        apart.resume_learner()
    apart.end()
    digests = audited(run_dir, UPDATES)
    assert digests[: len(before)] == before
    assert events(run_dir).count("resumed_by_log") == 2
    assert "resumed_state_differs" not in events(run_dir)
    verified(started, run_dir)
    found(f"CHAOS_SEED={SEED}: killed after update {len(before)} at last, all {UPDATES} states verified")
