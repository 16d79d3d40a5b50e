"""The study's statistics beside rliable's: what counts as a difference, and what is said without rliable."""

from __future__ import annotations

import pytest

from benchmarks.statistics import __main__ as comparison
from benchmarks.statistics.data import scores
from common.errors import ProcessError

INTERVALS = {"interquartile mean": [1.0, 0.5, 1.5], "probability of improvement": [0.6, 0.5, 0.7]}
SAME = INTERVALS | {"performance profile": [1.0, 0.5, 0.0]}


def wrong(other: dict[str, list[float]]) -> list[str]:
    return [each.what for each in comparison.differences(SAME, other) if not each.agrees]


def test_values_must_agree_to_rounding_and_ends_to_a_share_of_the_width() -> None:
    """Of the interval 0.5 to 1.5, an end may be 0.03 off."""
    assert wrong(SAME) == []
    assert wrong(SAME | {"interquartile mean": [1.0, 0.52, 1.5]}) == []
    assert wrong(SAME | {"interquartile mean": [1.0, 0.54, 1.5]}) == ["interquartile mean, lower end"]
    assert wrong(SAME | {"probability of improvement": [0.6001, 0.5, 0.7]}) == ["probability of improvement"]
    assert wrong(SAME | {"performance profile": [1.0, 0.4, 0.0]}) == ["performance profile, where furthest apart"]


def test_ours_are_of_all_tasks() -> None:
    """The interquartile mean of 80 scores: those of rank 21 to 60."""
    x, y = scores()
    pooled = sorted(value for task in x.values() for value in task)
    assert comparison.ours(x, y)["interquartile mean"][0] == pytest.approx(sum(pooled[20:60]) / 40)


def test_without_rliable(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """One sentence with the command that installs it."""
    monkeypatch.setattr(comparison, "PYTHON", comparison.ROOT / "build" / "nowhere" / "python")
    assert comparison.main() == ProcessError.exit_code
    assert "`make check-statistics`" in capsys.readouterr().err


def test_a_difference_is_an_exit_code(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(comparison, "ours", lambda x, y: SAME)
    monkeypatch.setattr(comparison, "theirs", lambda x, y: SAME | {"performance profile": [1.0, 0.4, 0.0]})
    assert comparison.main() == 1
    assert "differs by more than allowed: performance profile" in capsys.readouterr().out
