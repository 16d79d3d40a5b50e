"""The figures of a replay are those of its log and its clock."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from recorded_runs import UPDATES, made_up, write_log

from benchmarks import replay
from services.replay.verify import Divergence, Verdict

AGREED = Verdict(updates=UPDATES, tolerance_from=None, divergence=None, live_s=3.0, replay_s=2.0)


@pytest.fixture
def run_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small log, of which little is read."""
    monkeypatch.setattr(replay, "enable_compilation_cache", lambda: None)
    monkeypatch.setattr(replay, "READ_BYTES", 1e4)
    return write_log(tmp_path / "run", made_up().messages)


def test_reading_counts_rollout_messages(run_dir: Path) -> None:
    """Nine rollouts of about 1 kB each, and nothing else of the log."""
    found = replay.measure_reading(run_dir, rounds=2)
    assert 0.005 < found.megabytes < 0.02
    assert 0.0 < found.decoded_gb_s < found.bytes_gb_s < math.inf


def test_the_table_has_figures_and_goals(
    run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """3 s of the run in 2 s are 1.5 times its speed; the same in the file."""
    monkeypatch.setattr(replay, "measure_verify", lambda run_dir, until: AGREED)
    file = tmp_path / "figures.json"
    assert replay.main(["--run", str(run_dir), "--rounds", "1", "--json", str(file)]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "verify, by the speed of the run 1.50 1.2" in lines
    assert "updates equal bit for bit 4" in lines
    assert json.loads(file.read_text())["verify"]["live_s"] == 3.0


def test_the_speed_of_a_run_that_does_not_verify_means_nothing(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No figures, exit code 1."""
    diverged = Verdict(1, None, Divergence(2, "a", "b", ()), 3.0, 2.0)
    monkeypatch.setattr(replay, "measure_verify", lambda run_dir, until: diverged)
    assert replay.main(["--run", str(run_dir), "--rounds", "1"]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "does not verify" in printed.err
