"""`reskpn runs`: a table, the best, and deleting after a question."""

from __future__ import annotations

import fcntl
import io
import json
from pathlib import Path
from typing import Any

import pytest

from reskpn.cli import main

Captured = pytest.CaptureFixture[str]


def put(folder: Path, name: str, task: str, learner: str, episode_return: float | None) -> Path:
    run = folder / name
    (run / "log").mkdir(parents=True)
    (run / "settings.json").write_text(json.dumps({"task": task, "learner": learner, "seed": 3}))
    if episode_return is not None:
        summary = {"complete": True, "total_steps": 20_480, "eval_return_mean": episode_return}
        (run / "summary.json").write_text(json.dumps(summary))
    return run


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    put(tmp_path / "runs", "a", "hopper", "ppo", 10.0)
    put(tmp_path / "runs", "b", "hopper", "ppo", 30.0)
    put(tmp_path / "runs", "c", "hopper", "reskpn", 20.0)
    put(tmp_path / "runs", "d", "reacher", "ppo", None)
    return tmp_path / "runs"


def test_a_line_for_each_run(folder: Path, capsys: Captured) -> None:
    """Task, learner, seed, steps, return, state, size."""
    assert main(["runs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["run", "task", "learner", "seed", "steps", "return", "state", "size"]
    rows = {line.split()[0]: line.split()[1:] for line in lines[1:]}
    assert rows["b"][:6] == ["hopper", "ppo", "3", "20,480", "30.0", "finished"]
    assert rows["d"][:6] == ["reacher", "ppo", "3", "-", "-", "stopped"]
    assert len(rows) == 4


def test_the_best_of_each_task_and_learner(folder: Path, capsys: Captured) -> None:
    """Those without a return have none to compare; for machines as JSON."""
    assert main(["runs", "--best", "--json"]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(run["path"], run["episode_return"]) for run in found] == [("runs/b", 30.0), ("runs/c", 20.0)]


def test_no_runs(tmp_path: Path, capsys: Captured) -> None:
    """Is no error."""
    assert main(["runs", "--folder", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"no runs in {tmp_path}\n"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("answer", "stays"), [("y\n", False), ("Yes\n", False), ("\n", True), ("n\n", True)])
def test_deleting_asks_first(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured, answer: str, stays: bool
) -> None:
    """Only a yes deletes; the others stay in any case."""
    monkeypatch.setattr("sys.stdin", Terminal(answer))
    assert main(["runs", "--delete", "a"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("delete runs/a (ppo on hopper, 20,480 steps, finished, ")
    assert out.endswith("runs/a is kept\n" if stays else "runs/a is deleted\n")
    assert (folder / "a").exists() is stays
    assert (folder / "b").exists()


def test_deleting_without_a_terminal(folder: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    """Needs --yes."""
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert main(["runs", "--delete", "a"]) == 2
    assert "there is no terminal to ask at; give --yes as well" in capsys.readouterr().err
    assert main(["runs", "--delete", str(folder / "a"), "--yes"]) == 0
    assert not (folder / "a").exists()


def test_what_is_not_deleted(folder: Path, capsys: Captured, tmp_path: Path) -> None:
    """What is no run, a link to one, and a run that is running."""
    (folder / "notes").mkdir()
    (folder / "notes" / "mine.txt").write_text("")
    (folder / "link").symlink_to(folder / "a")
    for name in ("notes", "link", "nothing", str(tmp_path)):
        assert main(["runs", "--delete", name, "--yes"]) == 2
        assert "this is not the directory of a run" in capsys.readouterr().err
    with (folder / "a" / "log" / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert main(["runs", "--delete", "a", "--yes"]) == 2
        assert "this run is running; stop it first" in capsys.readouterr().err
    assert sorted(path.name for path in folder.iterdir()) == ["a", "b", "c", "d", "link", "notes"]


def test_files_that_cannot_be_removed(folder: Path, capsys: Captured, monkeypatch: Any) -> None:
    """One sentence."""

    def rmtree(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path / "log"))

    monkeypatch.setattr("shutil.rmtree", rmtree)
    assert main(["runs", "--delete", "a", "--yes"]) == 2
    assert "log cannot be removed (Permission denied)" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--folder", "x" * 300], ["--delete", "x" * 300], ["--delete", "a/" + "x" * 5000]])
def test_names_that_are_too_long(folder: Path, capsys: Captured, words: list[str]) -> None:
    """One sentence, no traceback."""
    assert main(["runs", *words]) == 2
    err = capsys.readouterr().err
    assert "cannot be read (File name too long)" in err
    assert len(err.splitlines()) == 1
