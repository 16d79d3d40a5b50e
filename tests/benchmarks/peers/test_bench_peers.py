"""Peers side by side: what each engine's process says, the table of physics, and what is said where one fails."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from benchmarks.peers import __main__ as peers
from benchmarks.peers import environment
from benchmarks.processes import run_json
from common.errors import ProcessError
from common.runtime import software_versions


def sample(steps_per_s: float) -> dict[str, Any]:
    return {"steps_per_s": steps_per_s, "versions": {"mujoco": "4.0.0"}, "cores": 2}


def test_ratios_are_taken_round_by_round() -> None:
    """Rounds of 100, 50 and 200 steps/s beside 50, 100 and 200: the ratios are 0.5, 2 and 1, so the median is 1."""
    rows = list(
        peers.physics_table(
            {"native": [sample(100), sample(50), sample(200)], "rollout": [sample(50), sample(100), sample(200)]}
        )
    )
    assert rows[2].startswith("| native | 100 | 1.00 | mujoco 4.0.0 | this project's engine")
    assert rows[3].startswith("| rollout | 100 | 1.00 | mujoco 4.0.0 | mujoco.rollout: physics alone")


def test_an_engine_is_timed_in_a_process_of_its_own() -> None:
    """`mujoco.rollout`, small: steps per second, versions and cores, as the last line."""
    found = run_json("benchmarks.peers.engines", ["rollout", "--num-envs", "2", "--steps", "3"])
    assert found["steps_per_s"] > 0
    assert found["versions"] == {"mujoco": software_versions()["mujoco"]}


def test_an_engine_that_fails_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """With its exit code and the last thing it said."""
    failed = subprocess.CompletedProcess([], 1, "", "Traceback\nValueError: no such model\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(ProcessError, match="rollout ended with exit code 1: ValueError: no such model"):
        peers.measure("rollout", "hopper", [])


def test_without_the_peers_nothing_is_begun(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence that names `make peers`, before anything is timed."""
    monkeypatch.setattr(environment, "ROOT", tmp_path)
    monkeypatch.setattr(environment, "PYTHON", tmp_path / "build" / "python")
    assert peers.main([]) != 0
    assert capsys.readouterr().err.startswith(
        "peers: the peers are not installed (build/python is missing): `make peers`"
    )


def test_an_unknown_task_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert peers.main(["--task", "hoper"]) == 2
    assert "did you mean 'hopper'" in capsys.readouterr().err
