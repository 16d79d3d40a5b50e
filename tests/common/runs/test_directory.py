"""The folder of a run: made, claimed once, and never half written."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.runs import directory as run_directory
from common.runs.directory import claim_run_dir, default_run_dir, prepare_run_dir, write_json


def settings(**values: Any) -> RunSettings:
    return RunSettings.model_validate(values)


def test_a_run_directory_is_made_and_holds_the_settings(tmp_path: Path) -> None:
    """With its parents; `settings.json` is the settings, whole."""
    given = settings(run_dir=tmp_path / "a" / "b", seed=5)
    assert prepare_run_dir(given) == tmp_path / "a" / "b"
    assert json.loads((tmp_path / "a" / "b" / "settings.json").read_text()) == given.model_dump(mode="json")


def test_a_directory_is_claimed_before_it_is_used(tmp_path: Path) -> None:
    """Claiming makes it and leaves it empty, so that the run's own process can claim it again."""
    given = settings(run_dir=tmp_path / "run")
    assert claim_run_dir(given) == tmp_path / "run"
    assert list((tmp_path / "run").iterdir()) == []
    assert prepare_run_dir(given) == tmp_path / "run"
    with pytest.raises(SettingsError, match="already holds a run"):
        claim_run_dir(given)


def test_a_directory_without_a_run_will_do(tmp_path: Path) -> None:
    """Also with other things in it, which stay."""
    (tmp_path / "notes.txt").write_text("mine")
    assert prepare_run_dir(settings(run_dir=tmp_path)) == tmp_path
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["summary.json", "settings.json", "log"])
@pytest.mark.parametrize("claim", [claim_run_dir, prepare_run_dir])
def test_a_directory_that_holds_a_run_is_refused(tmp_path: Path, name: str, claim: Any) -> None:
    """Nothing of an older run is overwritten; the message says by what it was known."""
    (tmp_path / name).write_text("older")
    with pytest.raises(SettingsError, match=rf"already holds a run \({name}\); choose another directory"):
        claim(settings(run_dir=tmp_path))
    assert (tmp_path / name).read_text() == "older"


@pytest.mark.parametrize(
    ("path", "why", "remedy"),
    [
        ("file/run", "Not a directory", "part of the path is a file: choose another directory"),
        ("file", "File exists", "something else is in its place: move that away or choose another directory"),
        ("x" * 300, "File name too long", "choose a shorter name"),
    ],
)
def test_a_directory_that_cannot_be_made_is_refused(tmp_path: Path, path: str, why: str, remedy: str) -> None:
    """A sentence with the reason, and what to do."""
    (tmp_path / "file").write_text("")
    with pytest.raises(SettingsError, match=rf"cannot be written \({why}\); {remedy}, with --run-dir"):
        prepare_run_dir(settings(run_dir=tmp_path / path))


def full(descriptor: int) -> None:
    """fsync on a disk that is full."""
    raise OSError(28, os.strerror(28))


def test_settings_that_cannot_be_written_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a full disk, too."""
    monkeypatch.setattr(run_directory.os, "fsync", full)
    with pytest.raises(SettingsError, match=r"cannot be written \(No space left on device\)"):
        prepare_run_dir(settings(run_dir=tmp_path))
    assert not (tmp_path / "settings.json").exists()


def test_the_default_directory_names_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Task, learner, seed and time, under runs/."""
    monkeypatch.setattr(run_directory, "time", SimpleNamespace(strftime=lambda form: "20250102-030405"))
    given = settings(task="hopper", learner="ppo", seed=3)
    assert default_run_dir(given) == Path("runs/hopper-ppo-s3-20250102-030405")


def test_runs_that_begin_in_one_second_have_directories_of_their_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The user did not choose the name, so it must not fail; each directory is made by the one that has it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_directory, "time", SimpleNamespace(strftime=lambda form: "20250102-030405"))
    given = settings(task="hopper", learner="ppo", seed=3)
    names = [claim_run_dir(given).name for _ in range(4)]
    first = "hopper-ppo-s3-20250102-030405"
    assert names == [first, f"{first}-2", f"{first}-3", f"{first}-4"]
    assert prepare_run_dir(given).name == f"{first}-5"
    with pytest.raises(SettingsError, match="already holds a run"):
        prepare_run_dir(given.model_copy(update={"run_dir": Path("runs") / f"{first}-5"}))


def test_json_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was there stays until the new content is on the disk."""
    path = tmp_path / "summary.json"
    write_json(path, {"a": 1})
    assert json.loads(path.read_text()) == {"a": 1}
    assert list(tmp_path.iterdir()) == [path]
    monkeypatch.setattr(run_directory.os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_json(path, {"a": 2})
    assert json.loads(path.read_text()) == {"a": 1}
