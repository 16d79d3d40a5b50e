"""`--from RUN[@VERSION]` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import reskpn.supervision.supervisor
from common.config.settings import RunSettings
from common.log.writer import LogWriter
from reskpn.cli import main
from reskpn.commands.beginning import origin_settings, parse_origin


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """A run of 100 updates of 640 steps with room for 100 centres."""
    settings = RunSettings(num_envs=64, num_steps=10, total_steps=64_000, run_dir=tmp_path / "a@b", seed=4)
    with LogWriter(tmp_path / "a@b" / "log") as log:
        log.write("/spec", {"run": "r", "settings": settings.model_dump(mode="json")})
    return tmp_path / "a@b"


def test_run_and_version() -> None:
    """The version is what stands behind the last @, if that is a number."""
    assert parse_origin("runs/a@12") == (Path("runs/a"), 12)
    assert parse_origin("runs/a") == (Path("runs/a"), None)
    assert parse_origin("runs/a@b") == (Path("runs/a@b"), None)


def test_the_settings_of_the_origin(run_dir: Path) -> None:
    """In place of the defaults, but for the directory; h keeps its size, whatever the new run's length."""
    settings = origin_settings(f"{run_dir}@3")
    assert (settings.seed, settings.num_envs, settings.run_dir) == (4, 64, None)
    assert settings.rkhs.capacity == 100


def test_a_new_run_with_other_settings(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is given on the command line counts, the rest is the origin's; the learner is told where to begin."""
    begun: list[tuple[RunSettings, Any]] = []
    monkeypatch.setattr(
        reskpn.supervision.supervisor,
        "train",
        lambda settings, *, origin, page, trace: begun.append((settings, origin)) or 0,
    )
    words = ["--algorithm.learning-rate", "1e-5", "--total-steps", "6400"]
    assert main(["train", "--from", f"{run_dir}@3", *words]) == 0
    ((settings, origin),) = begun
    assert (settings.algorithm.learning_rate, settings.total_steps, settings.seed) == (1e-5, 6400, 4)
    assert (settings.run_dir, origin) == (None, f"{run_dir}@3")


@pytest.mark.parametrize("command", ["train", "learner"])
def test_a_run_begins_in_one_way(run_dir: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    """--from and --resume exclude each other."""
    assert main([command, "--from", str(run_dir), "--resume", str(run_dir)]) == 2
    assert "give one of them" in capsys.readouterr().err
