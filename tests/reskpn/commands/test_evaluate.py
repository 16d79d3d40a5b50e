"""`reskpn evaluate`: what it plays and prints; episodes are made up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import UPDATES, made_up, trainer_settings, write_log

import common.physics.engines
import common.runtime
import services.worker.deterministic
from common.config.settings import RunSettings
from common.wire.messages import Snapshot, digest_arrays
from reskpn.cli import main
from services.learner.training.trainer import Trainer
from services.worker.deterministic import Episodes


@pytest.fixture(scope="module")
def policy() -> dict[str, np.ndarray]:
    return Trainer(trainer_settings()).policy_arrays()


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[tuple[RunSettings, int, Any]]:
    """Instead of simulating: settings, number of episodes and policy."""
    calls: list[tuple[RunSettings, int, Any]] = []

    class Made:
        def __init__(self, settings: RunSettings, reader: object, episodes: int, threads: int) -> None:
            self._given = settings, episodes

        def play(self, policy: Any) -> Episodes:
            calls.append((*self._given, policy))
            returns = np.arange(self._given[1], dtype=np.float32)
            return Episodes(returns, np.full(self._given[1], 7, np.int32), np.zeros((7, 2), np.float32))

    monkeypatch.setattr(services.worker.deterministic, "DeterministicEpisodes", Made)
    monkeypatch.setattr(common.runtime, "enable_compilation_cache", lambda: None)
    monkeypatch.setattr(common.physics.engines, "require_synchronous_dispatch", lambda: None)
    return calls


@pytest.fixture
def run_dir(policy: dict[str, np.ndarray], tmp_path: Path) -> Path:
    """Four updates, and the policy of the last in the log."""
    snapshot = Snapshot("run-1", UPDATES, digest_arrays(policy), policy).encode()
    return write_log(tmp_path / "x", [*made_up().messages, ("/policy", snapshot)])


def test_the_newest_policy(run_dir: Path, played: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """With the run's seed. Returns 0, 1, 2, 3: mean 1.5, standard deviation sqrt(1.25) = 1.1."""
    assert main(["evaluate", str(run_dir), "--episodes", "4", "--physics", "native"]) == 0
    out = capsys.readouterr().out
    assert f": policy {UPDATES} (from the log), seed {trainer_settings().seed}, physics native\n" in out
    assert "return 1.5 ± 1.1 (from 0.0 to 3.0) over 4 episodes of 7 steps on average" in out
    ((settings, episodes, _),) = played
    assert (settings.seed, settings.physics, episodes) == (trainer_settings().seed, "native", 4)


def test_another_seed_for_machines(run_dir: Path, played: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """Every episode is in one JSON object; networks are still those of the run."""
    words = ["--episodes", "2", "--seed", "9", "--physics", "native", "--version", str(UPDATES), "--json"]
    assert main(["evaluate", str(run_dir), *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["version"], found["seed"], found["recomputed"], found["exact"]) == (UPDATES, 9, False, True)
    assert (found["returns"], found["lengths"]) == ([0.0, 1.0], [7, 7])
    assert played[0][0].seed == 9


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--version", "5"], "--version 5: the log of "),
        (["--version", "-1"], "--version is -1; allowed: 0 or more"),
        (["--episodes", "0"], "--episodes is 0; allowed: 1 to "),
        (["--seed", "-3"], "--seed is -3; allowed: 0 to 4294967295"),
    ],
)
def test_what_is_not_possible(
    run_dir: Path, played: list[Any], capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    """One sentence, exit code 2, and nothing is played."""
    assert main(["evaluate", str(run_dir), *words]) == 2
    assert capsys.readouterr().err.startswith(f"reskpn evaluate: {sentence}")
    assert played == []


def test_no_run_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 5, as of every log that cannot be read."""
    assert main(["evaluate", str(tmp_path)]) == 5
    assert "Traceback" not in capsys.readouterr().err
