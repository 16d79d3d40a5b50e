"""What `repair` promises after a crash: whole files again, nothing of a whole chunk lost, nothing thrown away."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from common.errors import LogReadError, LogWriteError
from common.log.reader import LogReader
from common.log.repair import RepairedSegment, RepairReport, repair
from common.log.writer import LogWriter


def tear(path: Path, cut: int) -> bytes:
    """Leave the first `cut` bytes of the file; those cut off."""
    content = path.read_bytes()
    path.write_bytes(content[:cut])
    return content[cut:]


def chunk_ends(path: Path) -> list[int]:
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]


def names(directory: Path) -> set[str]:
    return {path.name for path in directory.iterdir()} - {".lock"}


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_a_torn_segment_is_made_whole(tmp_path: Path, write_log: Callable[..., Path], compression: Any) -> None:
    """Any MCAP program reads it again; its messages, metadata and attachments are kept, the rest is put aside."""
    path = write_log(tmp_path / "log", [400, 500, 600], compression=compression) / "00000.mcap"
    before = list(LogReader(path).messages())
    # the third chunk lacks its last 10 bytes
    tear(path, chunk_ends(path)[2] - 10)
    (torn,) = LogReader(path).torn
    tail = path.read_bytes()[torn.good_bytes :]
    assert len(tail) > 0

    aside = tmp_path / "log" / "00000.mcap.torn"
    assert repair(tmp_path) == RepairReport((RepairedSegment(path, 2, torn.dropped_bytes, aside),))

    assert aside.read_bytes() == tail
    reader = LogReader(tmp_path)
    assert list(reader.messages()) == before[:2]
    assert reader.torn == []
    assert reader.metadata()["versions"] == {"python": "3.11"}
    assert reader.attachments() == {"model.xml": ("application/xml", b"<mujoco/>")}
    with open(path, "rb") as file:
        plain = make_reader(file, validate_crcs=True)
        assert [m.data for _, _, m in plain.iter_messages()] == [m.data for m in before[:2]]
        summary = plain.get_summary()
        assert summary is not None
        assert {index.compression for index in summary.chunk_indexes} == {"" if compression == "none" else "lz4"}
    assert names(tmp_path / "log") == {"00000.mcap", "00000.mcap.torn"}


def test_whole_segments_are_not_touched(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """Only the torn one of three is rewritten, and a second repair finds nothing to do."""
    write_log(tmp_path, [100, 200, 300], segment_bytes=1)
    paths = [tmp_path / f"0000{number}.mcap" for number in range(3)]
    tear(paths[1], paths[1].stat().st_size - 1)
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in (paths[0], paths[2])}
    report = repair(tmp_path)
    assert [(segment.path, segment.messages) for segment in report.segments] == [(paths[1], 1)]
    assert {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in before} == before
    assert [len(m.data) for m in LogReader(tmp_path).messages()] == [100, 200, 300]
    assert repair(tmp_path) == RepairReport(())


@pytest.mark.parametrize("cut", [0, 5, 8, 20])
def test_a_segment_torn_at_its_very_start_becomes_an_empty_one(
    tmp_path: Path, write_log: Callable[..., Path], cut: int
) -> None:
    """The crash came before the first message: nothing to keep, and a file that every program can open."""
    path = write_log(tmp_path, [100]) / "00000.mcap"
    tear(path, cut)
    report = repair(tmp_path)
    assert [segment.messages for segment in report.segments] == [0]
    with open(path, "rb") as file:
        assert list(make_reader(file).iter_messages()) == []
    assert LogReader(tmp_path).torn == []


def test_a_run_goes_on_after_a_repair(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """The next writer begins the next segment, and the two read as one log."""
    path = write_log(tmp_path, [100, 200]) / "00000.mcap"
    tear(path, chunk_ends(path)[1])
    repair(tmp_path)
    with LogWriter(tmp_path) as log:
        log.write("/rollout", bytes(300))
    assert [len(m.data) for m in LogReader(tmp_path).messages()] == [100, 200, 300]


def test_a_log_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    """It looks torn only because it is not finished."""
    with LogWriter(tmp_path) as log:
        log.write("/rollout", b"live")
        log.flush(20.0)
        with pytest.raises(LogWriteError, match="being written by another process"):
            repair(tmp_path)
    assert [m.data for m in LogReader(tmp_path).messages()] == [b"live"]


def test_damage_before_the_torn_end_is_not_repaired_away(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """Messages that were acknowledged would be lost in silence: it is an error, and every file stays as it was."""
    path = write_log(tmp_path, [400, 500, 600]) / "00000.mcap"
    ends = chunk_ends(path)
    tear(path, ends[2] - 1)
    content = bytearray(path.read_bytes())
    content[ends[0] - 3] ^= 1
    path.write_bytes(content)
    with pytest.raises(LogReadError, match="is damaged at byte"):
        repair(tmp_path)
    assert path.read_bytes() == content
    assert names(tmp_path) == {"00000.mcap"}


def test_a_channel_of_a_newer_version_is_not_dropped(tmp_path: Path) -> None:
    """Repairing with an older version would lose its messages: refused, with the way out."""
    path = tmp_path / "00000.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="reskpn")
        channel = writer.register_channel("/hologram", "msgpack", 0)
        writer.add_message(channel, 0, b"new", 0, sequence=0)
        writer.flush()
    with pytest.raises(LogReadError, match="repair it with the version that wrote it"):
        repair(tmp_path)
    assert [(m.topic, m.data) for m in LogReader(tmp_path).messages()] == [("/hologram", b"new")]
    assert names(tmp_path) == {"00000.mcap"}


def test_an_interrupted_repair_is_begun_again(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """What an earlier attempt left beside the segment is not in the way."""
    path = write_log(tmp_path, [100, 200]) / "00000.mcap"
    tear(path, chunk_ends(path)[1] - 1)
    (tmp_path / "00000.mcap.repair").write_bytes(b"half a file")
    (tmp_path / "00000.mcap.torn").write_bytes(b"half a tail")
    (repaired,) = repair(tmp_path).segments
    assert repaired.torn_path is not None
    assert repaired.torn_path.stat().st_size == repaired.dropped_bytes
    assert [len(m.data) for m in LogReader(tmp_path).messages()] == [100]
    assert names(tmp_path) == {"00000.mcap", "00000.mcap.torn"}


def test_a_repair_without_room_changes_nothing(small_disk: Path, write_log: Callable[..., Path]) -> None:
    """The torn segment is as readable as before, and the sentence asks for space."""
    # 1.5 MB on a disk of 2 MiB: no room for a second copy
    path = write_log(small_disk, [500_000, 500_000, 500_000]) / "00000.mcap"
    tear(path, chunk_ends(path)[2])
    before = path.read_bytes()
    with pytest.raises(LogWriteError, match="free some space"):
        repair(small_disk)
    assert path.read_bytes() == before
    assert [len(m.data) for m in LogReader(small_disk).messages()] == [500_000] * 3
    assert names(small_disk) == {"00000.mcap"}


@pytest.mark.parametrize("into", [0, 4, 40, 390], ids=["behind", "the last number", "in the data", "most of it"])
def test_zeros_in_the_place_of_the_last_records(tmp_path: Path, write_log: Callable[..., Path], into: int) -> None:
    """As a file system leaves them after a loss of power: cut like any torn end, with every record before them."""
    path = write_log(tmp_path, [400, 500, 600]) / "00000.mcap"
    ends = chunk_ends(path)
    content = path.read_bytes()[: ends[1]]
    path.write_bytes(content[: len(content) - into] + bytes(4096 + into))
    whole = [400, 500] if into == 0 else [400]
    assert [len(message.data) for message in LogReader(tmp_path).messages()] == whole
    (repaired,) = repair(tmp_path).segments
    assert (repaired.messages, repaired.dropped_bytes > 0) == (len(whole), True)
    assert [len(message.data) for message in LogReader(tmp_path).messages()] == whole
    assert LogReader(tmp_path).torn == []


def test_zeros_and_then_something_else_is_damage(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """No loss of power writes behind its zeros."""
    path = write_log(tmp_path, [400, 500]) / "00000.mcap"
    content = path.read_bytes()[: chunk_ends(path)[1]]
    path.write_bytes(content + bytes(4096) + b"x")
    with pytest.raises(LogReadError, match="is damaged at byte"):
        repair(tmp_path)


def test_a_torn_file_that_is_a_link_does_not_lead_elsewhere(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """What is cut off is put into a new file of that name only; a link there is a reason to stop."""
    path = write_log(tmp_path / "log", [400, 500]) / "00000.mcap"
    tear(path, chunk_ends(path)[1] - 1)
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "log" / "00000.mcap.torn").symlink_to(victim)
    with pytest.raises(LogReadError, match="it is a symbolic link, which is not followed"):
        repair(tmp_path)
    assert victim.read_text() == "precious"
