"""A run that keeps no more of its log than its newest checkpoint needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.log.reader import LogReader
from common.log.segments import list_segments
from tests.chaos.interruptions import (
    OPTIONS,
    UPDATES,
    Processes,
    summary,
    train_until,
    verified,
)

pytestmark = pytest.mark.timeout(900)  # three processes load and compile at every start

KEEP = ["--log.keep", "1", "--log.segment-bytes", "60000"]


def removed(run_dir: Path) -> bool:
    """True once the first segment is gone."""
    segments = list_segments(run_dir / "log")
    return bool(segments) and segments[0].name != "00000.mcap"


def test_killed_and_resumed_with_retention(started: Processes, tmp_path: Path, undisturbed: list[str]) -> None:
    """A run that deletes old segments, killed when the first is gone, ends in the state of the undisturbed run. What is
    left of its log verifies from its checkpoint on, and the verification says what was removed."""
    run_dir = tmp_path / "run"
    train_until(started, run_dir, [*OPTIONS, *KEEP], lambda: removed(run_dir))
    printed = started.start("train", "--resume", run_dir).end()
    assert "environments of 2 slots" in printed
    updates = [message.json() for message in LogReader(run_dir).messages(["/update"])]
    assert [update["version"] for update in updates] == list(range(updates[0]["version"], UPDATES + 1))
    assert updates[0]["version"] > 20
    assert [update["state_digest"] for update in updates] == undisturbed[updates[0]["version"] - 1 :]
    assert summary(run_dir)["state_digest"] == undisturbed[-1]
    assert "updates were removed by retention (log.keep 1): nothing of them was verified" in verified(started, run_dir)
