"""The file in which an actor keeps what it does."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from common.errors import SettingsError
from services.worker.state_file import read_state, state_writer


def test_what_was_kept_last_is_read(tmp_path: Path) -> None:
    """State, version and when; nothing else is left in the folder."""
    file = tmp_path / "actor.json"
    before_s = time.time()
    keep = state_writer(file)
    keep("compiling", -1)
    keep("collecting", 7)
    found = read_state(file)
    assert found is not None
    assert (found.state, found.version) == ("collecting", 7)
    assert before_s <= found.time_s <= time.time()
    assert [path.name for path in tmp_path.iterdir()] == ["actor.json"]


def test_no_file_is_no_state(tmp_path: Path) -> None:
    """Nor is one in which nothing was kept yet."""
    file = tmp_path / "actor.json"
    assert read_state(file) is None
    state_writer(file)
    assert read_state(file) is None


def test_without_a_file_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And nothing fails."""
    monkeypatch.chdir(tmp_path)
    state_writer(None)("waiting", 3)
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    """At the start, with a sentence."""
    with pytest.raises(SettingsError, match=r"--state-file .* cannot be written .* does not exist: make it or choose"):
        state_writer(tmp_path / "nowhere" / "actor.json")


def test_a_folder_that_goes_away_does_not_stop_the_actor(tmp_path: Path) -> None:
    """The file is gone then, as its reader sees."""
    folder = tmp_path / "f"
    folder.mkdir()
    keep = state_writer(folder / "actor.json")
    (folder / "actor.json").unlink()
    folder.rmdir()
    keep("waiting", 3)
    assert read_state(folder / "actor.json") is None


@pytest.mark.parametrize("text", ["hello", "[1]", '{"state": "waiting"}', '{"state": "a", "version": 1, "more": 2}'])
def test_another_file_is_no_state(tmp_path: Path, text: str) -> None:
    """It is said, not guessed at."""
    file = tmp_path / "other.json"
    file.write_text(text)
    with pytest.raises(SettingsError, match=r"other\.json is not one that an actor keeps"):
        read_state(file)
