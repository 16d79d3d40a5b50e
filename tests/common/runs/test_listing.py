"""The runs of a folder, by what lies in their directories."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path

import pytest

from common.config.settings import RunSettings
from common.runs.listing import describe_run, list_runs, newest_run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "runs"


def put(path: Path, modified_s: float, *, summary: dict[str, object] | None = None, checkpoint: int = 0) -> Path:
    """A run with its settings: a batch of 8 x 8 = 64 steps."""
    (path / "log").mkdir(parents=True)
    (path / "checkpoints").mkdir()
    settings = RunSettings.model_validate(
        {"task": "hopper", "learner": "ppo", "seed": 3, "num_envs": 8, "num_steps": 8, "total_steps": 640}
    )
    (path / "settings.json").write_text(settings.model_dump_json())
    (path / "log" / "00000.mcap").write_bytes(b"x" * 1000)
    if summary is not None:
        (path / "summary.json").write_text(json.dumps(summary))
    if checkpoint:
        (path / "checkpoints" / f"{checkpoint:08d}.ckpt").write_bytes(b"")
    for file in [path / "settings.json", path / "summary.json", path / "log" / "00000.mcap"]:
        if file.exists():
            os.utime(file, (modified_s, modified_s))
    return path


def test_what_is_known_of_a_finished_run(folder: Path) -> None:
    """Steps and return are those of its summary."""
    summary = {"complete": True, "total_steps": 640, "eval_return_mean": 12.5, "train_return_mean": 9.0}
    found = describe_run(put(folder / "a", 1000.0, summary=summary))
    assert found is not None
    assert (found.task, found.learner, found.seed) == ("hopper", "ppo", 3)
    assert (found.env_steps, found.total_steps, found.episode_return) == (640, 640, 12.5)
    assert (found.state, found.modified_s) == ("finished", 1000.0)
    files = [entry for entry in (folder / "a").rglob("*") if entry.is_file()]
    assert found.size_bytes == sum(entry.stat().st_size for entry in files)


def test_a_run_without_an_evaluation(folder: Path) -> None:
    """Has the return of its training; one that was stopped is not finished."""
    summary = {"complete": False, "total_steps": 320, "eval_return_mean": None, "train_return_mean": 9.0}
    found = describe_run(put(folder / "a", 1000.0, summary=summary))
    assert found is not None
    assert (found.state, found.env_steps, found.episode_return) == ("stopped", 320, 9.0)


def test_a_run_that_was_killed(folder: Path) -> None:
    """The steps up to its newest checkpoint: version 5 of 64 steps each."""
    found = describe_run(put(folder / "a", 1000.0, checkpoint=5))
    assert found is not None
    assert (found.state, found.env_steps, found.episode_return) == ("stopped", 320, None)


def test_a_run_that_is_running(folder: Path) -> None:
    """Some process holds the lock of its log; that is found out without taking it."""
    run = put(folder / "a", 1000.0)
    with (run / "log" / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        found = describe_run(run)
        assert found is not None
        assert found.state == "running"
    found = describe_run(run)
    assert found is not None
    assert found.state == "stopped"


def test_the_newest_comes_first(folder: Path) -> None:
    """By the last change of its log, settings or summary; other folders are no runs, and links are not followed."""
    put(folder / "old", 1000.0)
    put(folder / "new", 3000.0)
    put(folder / "middle", 2000.0)
    (folder / "notes").mkdir()
    (folder / "notes" / "settings.json").write_text('{"editor": "mine"}')
    (folder / "link").symlink_to(folder / "old")
    assert [found.path.name for found in list_runs(folder)] == ["new", "middle", "old"]
    assert newest_run(folder) == folder / "new"


def test_a_run_that_is_just_starting(folder: Path) -> None:
    """`train` claims its directory seconds before the learner writes settings."""
    put(folder / "old", 1000.0)
    (folder / "new").mkdir()
    assert newest_run(folder) == folder / "new"
    found = describe_run(folder / "new")
    assert found is not None
    assert (found.state, found.task, found.seed) == ("starting", "-", None)


def test_no_runs(folder: Path) -> None:
    """Nor a folder."""
    assert (list_runs(folder), newest_run(folder)) == ([], None)
    assert describe_run(folder) is None


def test_a_finished_run_whose_log_is_still_open(folder: Path) -> None:
    """Is running until its learner has let go of it."""
    run = put(folder / "a", 1000.0, summary={"complete": True, "total_steps": 640})
    with (run / "log" / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        found = describe_run(run)
        assert found is not None
        assert found.state == "running"


@pytest.mark.parametrize("text", ["", "[]", '{"task": 3, "seed": "x", "num_envs": null}'])
def test_settings_that_are_damaged(folder: Path, text: str) -> None:
    """The run is listed, with what is known of it."""
    run = put(folder / "a", 1000.0, checkpoint=5)
    (run / "settings.json").write_text(text)
    (run / "summary.json").write_text("{")
    found = describe_run(run)
    assert found is not None
    assert (found.state, found.env_steps, found.seed) == ("stopped", None, None)
