"""What became slower is named, by ratios within one run."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import regressions
from benchmarks.regressions import MEASURED, report, slower
from benchmarks.update import CASES

OLD = {"hopper": {"a": 1.0, "b": 2.0, "gone": 1.0}}


def test_what_became_slower_is_named() -> None:
    """1.05 is within 1.1 times 1, 2.4 is 1.2 times 2; what only one side has is not compared."""
    new = {"hopper": {"a": 1.05, "b": 2.4, "new": 9.0}, "humanoid": {"a": 9.0}}
    assert slower(OLD, new) == ["hopper, b: 2.40, 1.20 times the committed 2.00"]


def test_what_became_faster_is_not() -> None:
    """Nothing is named, and the report says so."""
    machine = {"commit": "0123456789abcdef", "date": "today", "cores": "2", "cpu": "a processor"}
    lines = list(report({"machine": machine, "ratios": OLD}, {"hopper": {"a": 0.5}}))
    assert lines[0] == "committed: commit 0123456789ab, today, 2 cores of a processor"
    assert lines[-1] == "nothing is slower than 1.1 times the committed results"


def test_the_cases_that_are_compared_exist() -> None:
    """A renamed case would no longer be measured."""
    assert set(MEASURED) <= {case.name for case in CASES}


def test_without_committed_results(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is measured, and the sentence says how they are made."""
    monkeypatch.setattr(regressions, "RESULTS", tmp_path / "update.json")
    with pytest.raises(SystemExit):
        regressions.main([])
    assert "--record makes them, on a quiet machine" in capsys.readouterr().err
