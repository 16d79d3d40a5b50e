"""`reskpn play` with an exported policy: what it prints, and what it refuses. Runs: see test_evaluate.py."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import reskpn.playing
from common.physics.portable import Simulation
from reskpn.cli import main
from reskpn.policy_file import load

Output = pytest.CaptureFixture[str]


def play(*words: object) -> int:
    return main(["play", *map(str, words)])


def test_returns_and_lengths(exported: Path, capsys: Output) -> None:
    """Of inverted_pendulum, whose reward is 1 for every step, so that a return is a length."""
    assert play(exported, "--episodes", "3", "--json") == 0
    played = json.loads(capsys.readouterr().out)
    assert played["returns"] == played["lengths"]
    assert (played["version"], played["task"], played["seed"], len(played["returns"])) == (
        4,
        "inverted_pendulum",
        None,
        3,
    )
    assert play(exported, "--episodes", "3", "--task", "inverted_pendulum", "--physics", "native") == 0
    heading, figures = capsys.readouterr().out.splitlines()
    assert heading.endswith(": policy 4 of task inverted_pendulum, first states of the run, physics native")
    assert figures.startswith(f"return {sum(played['returns']) / 3:,.1f} ± ")
    assert " over 3 episodes of " in figures


def test_seeds_draw_first_states(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same seed begins in the same states, another one in others; without one, the first so many are taken."""
    begun: list[int] = []
    reset = Simulation.reset

    def recorded(self: Simulation, number: int) -> np.ndarray:
        begun.append(number)
        return reset(self, number)

    monkeypatch.setattr(Simulation, "reset", recorded)
    policy = load(exported)
    for seed in (None, 1, 1, 2):
        reskpn.playing.play(policy, 3, seed)
    assert begun[:3] == [0, 1, 2]
    assert begun[3:6] == begun[6:9]
    assert len(set(begun[3:6])) == 3
    assert begun[6:9] != begun[9:]


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (["--task", "hopper"], 5, "{path} is a policy of task inverted_pendulum, not of hopper"),
        (["--episodes", "0"], 2, "--episodes is 0; allowed: 1 to 1024"),
        (["--episodes", "1025"], 2, "--episodes is 1025; allowed: 1 to 1024"),
        (["--version", "3"], 2, "--version is for runs; {path} holds one policy"),
        (["--threads", "2"], 2, "--threads is for runs; an exported policy is played on one thread"),
        (["--physics", "mjx"], 2, "--physics is mjx; an exported policy is played with native"),
        (["--seed", "-1"], 2, "--seed is -1; allowed: 0 to 4294967295"),
    ],
)
def test_what_is_not_possible(exported: Path, capsys: Output, words: list[str], code: int, sentence: str) -> None:
    """One sentence."""
    assert play(exported, *words) == code
    assert capsys.readouterr().err == f"reskpn play: {sentence.format(path=exported)}\n"


def test_a_run_of_another_task(run_dir: Path, capsys: Output) -> None:
    """It is refused before anything is played."""
    assert play(run_dir, "--task", "hopper") == 2
    assert "--task hopper: the run is of task inverted_pendulum" in capsys.readouterr().err


def test_nothing_there(tmp_path: Path, capsys: Output) -> None:
    """A file and a run that do not exist."""
    assert play(tmp_path / "absent.onnx") == 5
    assert "absent.onnx cannot be read" in capsys.readouterr().err
    assert play(tmp_path / "absent") == 5
    assert "Traceback" not in capsys.readouterr().err
