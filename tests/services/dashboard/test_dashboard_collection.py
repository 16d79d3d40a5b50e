"""The runs that a page can show, and by which names."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from dashboard_runs import write_run

from common.errors import SettingsError
from common.log.lock import LogLock
from services.dashboard.collection import RunCollection, check_paths

DEADLINE_S = 20.0


def test_a_folder_of_runs(make_run: Callable[..., Path], collection: Callable[..., RunCollection]) -> None:
    """All of them with what their directories say; a new one is found at the next look."""
    make_run("one", updates=2)
    make_run("two", updates=100, complete=True)
    runs = collection()
    entries = {entry["id"]: entry for entry in runs.entries()}
    assert set(entries) == {"one", "two"}
    assert (entries["two"]["state"], entries["two"]["return"], entries["two"]["env_steps"]) == ("finished", 12.5, 1200)
    make_run("three")
    runs.look()
    assert {entry["id"] for entry in runs.entries()} == {"one", "two", "three"}


def test_the_run_that_is_running_is_shown_first(
    make_run: Callable[..., Path], collection: Callable[..., RunCollection]
) -> None:
    """Though another one was changed later."""
    running = make_run("running")
    make_run("newer", complete=True)
    os.utime(running / "log" / "00000.mcap", (10, 10))
    with LogLock(running / "log"):
        runs = collection()
        assert runs.default() == ["running"]
        assert runs.running() == ["running"]


def test_a_log_that_grows_is_of_a_running_run(
    make_run: Callable[..., Path], collection: Callable[..., RunCollection]
) -> None:
    """Locks of another container cannot be seen; the time of the newest file can."""
    make_run("fresh")
    old = make_run("old")
    for path in (old, old / "settings.json", old / "log" / "00000.mcap"):
        os.utime(path, (10, 10))
    assert collection().running() == ["fresh"]


def test_two_runs_with_one_name(tmp_path: Path, collection: Callable[..., RunCollection]) -> None:
    """Are told apart by their whole paths."""
    one, other = write_run(tmp_path / "a" / "run"), write_run(tmp_path / "b" / "run")
    assert {entry["id"] for entry in collection(one, other).entries()} == {str(one), str(other)}


def test_names_are_looked_up_and_are_no_paths(
    tmp_path: Path, make_run: Callable[..., Path], collection: Callable[..., RunCollection]
) -> None:
    """Only runs that were found can be asked for."""
    make_run("one")
    write_run(tmp_path / "secret")
    runs = collection()
    assert [run.identity for run in runs.looked_at(["one", "../secret", str(tmp_path / "secret"), ""])] == ["one"]


def test_runs_are_followed_while_they_are_looked_at(
    make_run: Callable[..., Path], collection: Callable[..., RunCollection], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not before, and no longer than a while after."""
    monkeypatch.setattr("services.dashboard.collection.IDLE_S", 0.5)
    monkeypatch.setattr("services.dashboard.collection.POLL_S", 0.01)
    make_run("one", updates=3, complete=True)
    runs = collection()
    polled = threading.Event()
    runs.start()
    (run,) = runs.looked_at(["one"])
    end_s = time.monotonic() + DEADLINE_S
    while run.view.latest.get("version") != 3:
        assert time.monotonic() < end_s
        polled.wait(0.01)
    original = run.poll
    monkeypatch.setattr(run, "poll", lambda: polled.set() or original())
    while time.monotonic() - run.touched_s < 0.6:
        threading.Event().wait(0.05)
    polled.clear()
    assert not polled.wait(0.2)


@pytest.mark.parametrize("names", [[], ["processes"], ["processes", "log"]])
def test_a_run_that_is_about_to_begin(
    tmp_path: Path, names: list[str], collection: Callable[..., RunCollection]
) -> None:
    """`train --dashboard` shows its directory before the learner has written to it: it is a run that starts."""
    run = tmp_path / "new"
    run.mkdir()
    for name in names:
        (run / name).mkdir()
    check_paths([run])
    (entry,) = collection(run).entries()
    assert (entry["id"], entry["state"]) == ("new", "starting")


def test_paths_that_hold_no_run(tmp_path: Path) -> None:
    """One sentence each."""
    with pytest.raises(SettingsError, match=f"--run-dir {tmp_path / 'none'}: there is no such directory"):
        check_paths([tmp_path / "none"])
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(SettingsError, match=f"--run-dir {tmp_path}: holds no run"):
        check_paths([tmp_path])
