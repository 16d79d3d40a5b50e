"""A log that is followed while it grows: each message once, and nothing read twice."""

from __future__ import annotations

from pathlib import Path

import pytest

from common.errors import LogReadError
from common.log import segment_reader
from common.log.follower import LogFollower
from common.log.writer import LogWriter

DEADLINE_S = 20.0


def numbers(follower: LogFollower, most: int = 100) -> list[int]:
    return [message.json()["n"] for message in follower.read(most)]


def test_each_message_comes_once_while_the_log_grows(tmp_path: Path) -> None:
    """Nothing before there is a log; then what was added since the last look, in order, of the wanted topics alone."""
    follower = LogFollower(tmp_path, ["/update", "/eval"])
    assert follower.read(100) == []
    with LogWriter(tmp_path / "log") as log:
        log.write("/update", {"n": 1})
        log.write("/event", {"n": -1})
        log.flush(DEADLINE_S)
        assert numbers(follower) == [1]
        assert numbers(follower) == []
        log.write("/eval", {"n": 2})
        log.write("/update", {"n": 3})
        log.flush(DEADLINE_S)
        assert numbers(follower) == [2, 3]
    assert numbers(follower) == []


def test_it_goes_on_in_the_next_segment(tmp_path: Path) -> None:
    """Of one writer, whose segments are of two messages here, and of the learner that resumes the run."""
    follower = LogFollower(tmp_path, ["/update"])
    for life in (0, 10):
        with LogWriter(tmp_path / "log", segment_messages=2) as log:
            for number in range(5):
                log.write("/update", {"n": life + number})
                log.flush(DEADLINE_S)
        assert numbers(follower) == [life + number for number in range(5)]


def test_no_more_than_asked_for_at_once(tmp_path: Path) -> None:
    """A long log comes in parts, so that its reader can do something else in between."""
    follower = LogFollower(tmp_path, ["/update"])
    with LogWriter(tmp_path / "log", segment_messages=3) as log:
        for number in range(8):
            log.write("/update", {"n": number})
            log.flush(DEADLINE_S)
    assert [numbers(follower, 2) for _ in range(5)] == [[0, 1], [2, 3], [4, 5], [6, 7], []]


def test_what_was_read_is_not_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks read over the whole time are as many as were written; a look at a log that did not grow reads none."""
    read: list[int] = []
    original = segment_reader.read_chunk

    def counting(*given: object) -> object:
        read.append(1)
        return original(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(segment_reader, "read_chunk", counting)
    follower = LogFollower(tmp_path, ["/update"])
    with LogWriter(tmp_path / "log") as log:
        for number in range(6):
            log.write("/update", {"n": number})
            log.flush(DEADLINE_S)
            assert numbers(follower) == [number]
            assert numbers(follower) == []
    assert len(read) == 6


def test_a_torn_tail_is_left_until_it_is_whole(tmp_path: Path) -> None:
    """Half a record at the end is none yet; its message comes when the rest is there."""
    with LogWriter(tmp_path / "log") as log:
        log.write("/update", {"n": 1})
        log.flush(DEADLINE_S)
        before = (tmp_path / "log" / "00000.mcap").read_bytes()
        log.write("/update", {"n": 2})
        log.flush(DEADLINE_S)
        after = (tmp_path / "log" / "00000.mcap").read_bytes()
    growing = tmp_path / "copy" / "log" / "00000.mcap"
    growing.parent.mkdir(parents=True)
    follower = LogFollower(tmp_path / "copy", ["/update"])
    growing.write_bytes(before)
    assert numbers(follower) == [1]
    growing.write_bytes(after[: len(before) + 20])
    assert numbers(follower) == []
    growing.write_bytes(after)
    assert numbers(follower) == [2]


def test_segments_that_a_run_does_not_keep_are_passed_over(tmp_path: Path) -> None:
    """`log.keep` deletes the first ones, perhaps before they were read to their end."""
    follower = LogFollower(tmp_path, ["/update"])
    with LogWriter(tmp_path / "log", segment_messages=2) as log:
        for number in range(6):
            log.write("/update", {"n": number})
            log.flush(DEADLINE_S)
    assert numbers(follower, 1) == [0]
    for name in ("00000.mcap", "00001.mcap"):
        (tmp_path / "log" / name).unlink()
    assert numbers(follower) == [4, 5]


@pytest.mark.parametrize("change", ["shorter", "changed", "removed"])
def test_a_log_that_is_not_what_it_was(tmp_path: Path, change: str) -> None:
    """Is said to be damaged, and where."""
    with LogWriter(tmp_path / "log") as log:
        log.write("/update", {"n": 1, "filling": "x" * 200})
    follower = LogFollower(tmp_path, ["/update"])
    first = tmp_path / "log" / "00000.mcap"
    if change == "changed":
        data = bytearray(first.read_bytes())
        data[data.index(b"x" * 200) + 7] ^= 1
        first.write_bytes(data)
    else:
        assert numbers(follower) == [1]
    if change == "shorter":
        first.write_bytes(first.read_bytes()[:40])
    if change == "removed":
        first.unlink()
    with pytest.raises(LogReadError, match=r"00000\.mcap|no log in"):
        follower.read(100)
