"""`reskpn.train`: settings, progress and failures; processes are made up. tests/whole_runs has a real run."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import reskpn
import reskpn.api.training as training
from common.config.settings import RunSettings
from common.errors import ProcessError, SettingsError
from common.wire.report import Progress

TINY = {"num_envs": 32, "num_steps": 8, "total_steps": 512, "actors": 1, "algorithm": {"minibatches": 4}}


def progress(version: int) -> Progress:
    return Progress(
        phase="training", text="", version=version, updates=2, env_steps=256 * version, total_steps=512,
        steps_per_s=10.0, train_return=1.0, staleness=0.0,
    )  # fmt: skip


@pytest.fixture
def supervised(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[RunSettings]]:
    """Instead of processes: what `supervise` does and returns, and the settings that it was given."""

    def prepare(code: int, run: Callable[[RunSettings, Callable[[], None]], None]) -> list[RunSettings]:
        given: list[RunSettings] = []

        def supervise(settings: RunSettings, *, on_poll: Callable[[], None], output: int) -> int:
            given.append(settings)
            run(settings, on_poll)
            return code

        monkeypatch.setattr(training, "supervise", supervise)
        monkeypatch.setattr(training, "open_run", lambda path: path)
        return given

    return prepare


def nothing(*_: object) -> None:
    """A run in which nothing happens."""


def test_settings_are_those_of_a_run(supervised: Any, tmp_path: Path) -> None:
    """Groups are maps, paths are paths; the run has a directory and a free port."""
    given = supervised(0, nothing)
    found: Any = reskpn.train("hopper", "ppo", run_dir=tmp_path / "x", seed=3, **TINY)
    assert found == tmp_path / "x"
    (settings,) = given
    assert (settings.task, settings.learner, settings.seed, settings.algorithm.minibatches) == ("hopper", "ppo", 3, 4)
    assert settings.transport.endpoint.startswith("tcp/127.0.0.1:")


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"learner": "pp"}, "pp"),
        ({"sed": 3}, "sed"),
        ({"actors": object()}, "a setting is neither text, number, list nor map"),
        ({"algorithm": {"gamma": 2.0}}, "gamma"),
    ],
)
def test_impossible_settings(supervised: Any, tmp_path: Path, given: dict[str, Any], sentence: str) -> None:
    """A sentence, and no run directory."""
    supervised(0, nothing)
    with pytest.raises(SettingsError, match=sentence):
        reskpn.train("hopper", run_dir=tmp_path / "x", **(TINY | given))
    assert not (tmp_path / "x").exists()


def test_progress_is_told_in_the_callers_thread(
    supervised: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each report once, and the end with the figures of the summary."""
    answers = iter([progress(1), progress(2)])
    asked = threading.Event()

    class Report:
        def __init__(self) -> None:
            self.progress = next(answers, None)

    class Session:
        def __enter__(self) -> Session:
            return self

        def __exit__(self, *_: object) -> None:
            pass

    def ask(*_: object) -> Report:
        asked.set()
        return Report()

    told: list[tuple[Progress, str]] = []

    def run(settings: RunSettings, on_poll: Callable[[], None]) -> None:
        assert asked.wait(10.0)
        while not told:
            on_poll()
        (tmp_path / "x" / "summary.json").write_text(json.dumps({"updates": 2, "total_steps": 512}))

    monkeypatch.setattr(training, "ASK_EVERY_S", 0.01)
    monkeypatch.setattr(training, "connect", lambda *_: Session())
    monkeypatch.setattr(training, "ask", ask)
    supervised(0, run)
    name = threading.current_thread().name
    tell = lambda one: told.append((one, threading.current_thread().name))  # noqa: E731
    reskpn.train("hopper", run_dir=tmp_path / "x", on_progress=tell, **TINY)
    assert {thread for _, thread in told} == {name}
    last, _ = told[-1]
    assert (last.phase, last.version, last.env_steps) == ("finished", 2, 512)


def test_a_failed_run(supervised: Any, tmp_path: Path) -> None:
    """The exit code, and the end of what the learner printed."""

    def run(settings: RunSettings, on_poll: Callable[[], None]) -> None:
        (tmp_path / "x" / "processes" / "learner.txt").write_text("one\ntwo\n")

    supervised(7, run)
    with pytest.raises(ProcessError, match=r"ended with exit code 7; the end of its output \(.*\):\n  one\n  two"):
        reskpn.train("hopper", run_dir=tmp_path / "x", **TINY)


def test_a_directory_that_holds_a_run(supervised: Any, tmp_path: Path) -> None:
    """It is refused, as by the command."""
    supervised(0, nothing)
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(SettingsError, match="already holds a run"):
        reskpn.train("hopper", run_dir=tmp_path, **TINY)
