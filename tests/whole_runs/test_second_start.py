"""A second start finds its programs in the cache: counted, not timed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks import start
from benchmarks.processes import run_json
from common.runtime import CACHE_VARIABLE

TINY = [
    *("--config", "paper"),
    *("--task", "inverted_pendulum", "--physics", "native", "--num-envs", "8", "--num-steps", "4", "--learner", "ppo"),
    *("--algorithm.hidden", "8,8", "--algorithm.minibatches", "2", "--actors", "1", "--episode-length", "10"),
]


@pytest.mark.parametrize("role", ["learner", "actor"])
def test_a_second_start_compiles_nothing(role: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Learner, and actor with native physics: every program comes from the cache, and computes the same bits."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    first, second = (run_json("benchmarks.start_phases", ["--role", role, *TINY]) for _ in range(2))
    assert first["programs"] > first["cached"]
    assert second["programs"] == first["programs"] == second["cached"]
    assert second["digest"] == first["digest"]


def report(compiling: float, digest: str) -> dict[str, Any]:
    """A role whose programs took this long."""
    names = {name for phases in start.COMPILING.values() for name in phases} | {"imports"}
    return {
        "seconds": {name: [compiling / 2, 1.0] for name in names},
        "programs": 9,
        "cached": 3,
        "digest": digest,
    }


@pytest.mark.parametrize(
    ("compiling", "digest", "expected"),
    [
        (4.0, "a", ["at most 5 s, met (4.0 s)", "the same bits at every start"]),
        (6.0, "b", ["at most 5 s, missed (6.0 s)", "OTHER BITS than at the first start"]),
    ],
)
def test_the_verdict_is_about_the_later_starts(compiling: float, digest: str, expected: list[str]) -> None:
    """The first start may take its time; bits must be those of the first."""
    roles = {role: report(30.0, "a") for role in start.ROLES}
    later = {role: report(compiling, digest) for role in start.ROLES}
    lines = list(start.tables([start.Start(roles, 40.0), start.Start(later, 12.0)]))
    text = "\n".join(lines)
    assert "| learner: programs, of them from the cache | 9, 3 | 9, 3 |" in lines
    assert f"| **actor: until its programs are there** | 30.0 (2.0) | {compiling:.1f} (2.0) |" in lines
    assert all(text.count(words) == 2 for words in expected)
    assert "| **`reskpn train` to the first update** | 40.0 | 12.0 |" in lines


def test_one_start_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """It would only fill the cache."""
    with pytest.raises(SystemExit):
        start.main(["--starts", "1"])
    assert "must be at least 2" in capsys.readouterr().err
