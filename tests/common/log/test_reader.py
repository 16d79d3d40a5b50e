"""What `LogReader` promises: every whole message, or an error that says where the log stops being one."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from common.errors import LogReadError
from common.log.reader import LogReader, TornTail
from common.log.records import CHANNELS
from common.log.writer import LogWriter

SIZES = [100, 0, 3000, 7, 500, 64, 1200]


@dataclass(frozen=True)
class Sample:
    """A finished segment, a place for altered copies of it, and what mcap itself says of its chunks."""

    content: bytes
    messages: list[bytes]
    chunk_starts: list[int]
    chunk_ends: list[int]
    copy: Path

    def with_content(self, content: bytes) -> Path:
        self.copy.write_bytes(content)
        return self.copy


@pytest.fixture(params=["none", "lz4"])
def sample(request: pytest.FixtureRequest, tmp_path: Path, write_log: Callable[..., Path]) -> Sample:
    """Seven messages in seven chunks."""
    path = write_log(tmp_path / "log", SIZES, compression=request.param) / "00000.mcap"
    with open(path, "rb") as file:
        reader = make_reader(file)
        messages = [m.data for _, _, m in reader.iter_messages()]
        summary = reader.get_summary()
    assert summary is not None
    starts = [index.chunk_start_offset for index in summary.chunk_indexes]
    ends = [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]
    assert [len(data) for data in messages] == SIZES
    return Sample(path.read_bytes(), messages, starts, ends, tmp_path / "copy.mcap")


def data_of(path: Path) -> list[bytes]:
    return [m.data for m in LogReader(path).messages()]


def check_cut(sample: Sample, cut: int) -> None:
    path = sample.with_content(sample.content[:cut])
    whole_chunks = sum(end <= cut for end in sample.chunk_ends)
    reader = LogReader(path)
    assert [m.data for m in reader.messages()] == sample.messages[:whole_chunks]
    assert reader.counts() == ({"/rollout": whole_chunks} if whole_chunks else {})
    if cut == len(sample.content):
        assert reader.torn == []
        return
    (torn,) = reader.torn
    assert torn.path == path
    assert torn.good_bytes + torn.dropped_bytes == cut
    assert torn.good_bytes >= max([end for end in sample.chunk_ends if end <= cut], default=0)
    # what is called good reads the same without the rest
    assert LogReader(sample.with_content(sample.content[: torn.good_bytes])).torn == [
        TornTail(path, torn.good_bytes, 0)
    ]


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_file_cut_at_any_byte_gives_its_whole_chunks(sample: Sample, data: st.DataObject) -> None:
    """Never an error, never a torn message: a prefix, and a report of what was dropped."""
    check_cut(sample, data.draw(st.integers(0, len(sample.content)), label="cut"))


def test_a_file_cut_at_the_edge_of_a_chunk_gives_its_whole_chunks(sample: Sample) -> None:
    """The edges, which random cuts seldom meet: one byte before, at and after every end, and around the magic."""
    edges = {end + step for end in [*sample.chunk_ends, len(sample.content) - 8] for step in (-1, 0, 1)}
    for cut in sorted(edges | {0, 1, 7, 8, 9, 16, 17, 18, len(sample.content) - 1, len(sample.content)}):
        check_cut(sample, cut)


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_changed_byte_is_noticed_or_harmless(sample: Sample, data: st.DataObject) -> None:
    """Whatever byte is changed: either LogReadError, or all messages as they were (it was in no message's way)."""
    position = data.draw(st.integers(0, len(sample.content) - 1), label="position")
    change = data.draw(st.integers(1, 255), label="change")
    content = bytearray(sample.content)
    content[position] ^= change
    path = sample.with_content(bytes(content))
    found: list[bytes] = []
    refusal = ""
    try:
        reader = LogReader(path)
        found.extend(m.data for m in reader.messages())
        reader.counts()
        reader.metadata()
        reader.attachments()
        assert [torn.path for torn in reader.torn] in ([], [path])
    except LogReadError as error:
        refusal = str(error)
    assert found == sample.messages[: len(found)]
    assert len(found) == len(sample.messages) or str(path) in refusal


def test_damage_in_the_middle_stops_the_reader_at_its_place(sample: Sample) -> None:
    """The messages before are given out, then an error with path and offset; nothing after is trusted."""
    content = bytearray(sample.content)
    content[sample.chunk_ends[2] - 5] ^= 0x40
    path = sample.with_content(bytes(content))
    found: list[bytes] = []
    with pytest.raises(LogReadError) as caught:
        found.extend(iter_data(path))
    assert found == sample.messages[:2]
    assert f"{path} is damaged at byte {sample.chunk_starts[2]}:" in str(caught.value)


def iter_data(path: Path) -> Iterator[bytes]:
    for message in LogReader(path).messages():
        yield message.data


@pytest.mark.parametrize("finished", [True, False])
def test_a_chunk_that_is_missing_is_noticed(sample: Sample, finished: bool) -> None:
    """The bytes around a cut-out chunk are perfect; the count of the messages is not."""
    end = len(sample.content) if finished else sample.chunk_ends[6]
    content = sample.content[: sample.chunk_starts[3]] + sample.content[sample.chunk_starts[4] : end]
    found: list[bytes] = []
    with pytest.raises(LogReadError):
        found.extend(iter_data(sample.with_content(content)))
    assert found == sample.messages[: len(found)]
    assert len(found) <= 3


def test_a_run_its_log_and_a_file_can_be_read(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """Whichever of the three a person names."""
    write_log(tmp_path / "log", [10, 20], segment_bytes=1)
    for path in (tmp_path, tmp_path / "log"):
        assert [len(data) for data in data_of(path)] == [10, 20]
    assert [len(data) for data in data_of(tmp_path / "log" / "00001.mcap")] == [20]


def test_what_is_not_a_log_is_said_in_a_sentence(tmp_path: Path) -> None:
    """Absent, empty, not MCAP, and MCAP of another program: each says what it found and what to give."""
    with pytest.raises(LogReadError, match=r"absent does not exist; give a run directory"):
        LogReader(tmp_path / "absent")
    with pytest.raises(LogReadError, match=r"no log in .*: neither it nor its folder 'log' holds a 00000\.mcap"):
        LogReader(tmp_path)
    text = tmp_path / "notes.mcap"
    text.write_text("these are notes")
    with pytest.raises(LogReadError, match="is not an MCAP file"):
        data_of(text)
    foreign = tmp_path / "foreign.mcap"
    with open(foreign, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        writer.finish()
    with pytest.raises(LogReadError, match="of another program: its profile is 'ros2'"):
        data_of(foreign)


def test_a_missing_segment_is_not_skipped(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """A hole is an error that names the file; a log whose beginning was pruned is read."""
    write_log(tmp_path, [10, 20, 30], segment_bytes=1)
    (tmp_path / "00001.mcap").rename(tmp_path / "elsewhere")
    with pytest.raises(LogReadError, match=r"00001\.mcap is missing"):
        LogReader(tmp_path)
    (tmp_path / "elsewhere").rename(tmp_path / "00001.mcap")
    (tmp_path / "00000.mcap").unlink()
    assert [len(data) for data in data_of(tmp_path)] == [20, 30]


def test_topics_select_and_a_wrong_one_is_refused(tmp_path: Path) -> None:
    """A misspelt topic would otherwise read as a run in which nothing happened."""
    with LogWriter(tmp_path) as log:
        for number in range(3):
            log.write("/rollout", b"%d" % number)
            log.write("/update", {"version": number})
    chosen = list(LogReader(tmp_path).messages({"/update"}))
    assert [m.json() for m in chosen] == [{"version": number} for number in range(3)]
    assert [m.sequence for m in chosen] == [1, 3, 5]
    with pytest.raises(LogReadError, match=r"'/updates' is not a topic of the log; did you mean '/update'"):
        LogReader(tmp_path).messages({"/updates"})


def test_counts_are_the_same_with_and_without_a_footer(tmp_path: Path) -> None:
    """A finished segment has them in its summary, a torn one is read for them."""
    with LogWriter(tmp_path) as log:
        for topic in CHANNELS:
            log.write(topic, b"{}")
        log.write("/event", b"{}")
    expected = {topic: 2 if topic == "/event" else 1 for topic in CHANNELS}
    assert LogReader(tmp_path).counts() == expected
    path = tmp_path / "00000.mcap"
    path.write_bytes(path.read_bytes()[:-1])
    assert LogReader(tmp_path).counts() == expected


def test_attachments_and_metadata_come_back(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """With their media types, and damage to an attachment is noticed by its CRC."""
    write_log(tmp_path, [10])
    reader = LogReader(tmp_path)
    assert reader.attachments() == {"model.xml": ("application/xml", b"<mujoco/>")}
    assert reader.metadata()["run"] == {"name": "probe", "git_commit": "0123abcd"}
    path = tmp_path / "00000.mcap"
    path.write_bytes(path.read_bytes().replace(b"<mujoco/>", b"<mujocO/>"))
    with pytest.raises(LogReadError, match="CRC of an attachment"):
        LogReader(tmp_path).attachments()


def test_a_reader_sees_the_log_as_it_was_when_opened(tmp_path: Path) -> None:
    """Also while it is being written: what comes later needs a new reader."""
    with LogWriter(tmp_path) as log:
        log.write("/rollout", b"early")
        log.flush(20.0)
        reader = LogReader(tmp_path)
        log.write("/rollout", b"late")
        log.flush(20.0)
        assert [m.data for m in reader.messages()] == [b"early"]
        assert [torn.dropped_bytes for torn in reader.torn] == [0]
        assert data_of(tmp_path) == [b"early", b"late"]


def test_one_chunk_is_held_at_a_time(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """Memory does not grow with the log: 12 chunks of 2 MB are read within the room of three."""
    size = 2_000_000
    write_log(tmp_path, [size] * 12)
    tracemalloc.start()
    try:
        total = sum(len(m.data) for m in LogReader(tmp_path).messages())
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert total == 12 * size
    assert peak < 3 * size


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_log_that_was_recompressed_is_read(tmp_path: Path, compression: CompressionType) -> None:
    """People shrink old logs with MCAP's own tools; those change the compression and the chunks, nothing else."""
    path = tmp_path / "00000.mcap"
    with open(path, "wb") as file:
        writer = Writer(file, compression=compression)
        writer.start(profile="reskpn")
        channel = writer.register_channel("/rollout", "msgpack", 0)
        for number in range(5):
            writer.add_message(channel, number, b"%d" % number * 1000, number, sequence=number)
        writer.finish()
    assert data_of(path) == [b"%d" % number * 1000 for number in range(5)]


def test_a_chunk_is_not_decompressed_beyond_its_size(tmp_path: Path) -> None:
    """A head that says less than there is does not decide what is held in memory: the rest is never made."""
    path = tmp_path / "00000.mcap"
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start(profile="reskpn")
        channel = writer.register_channel("/rollout", "msgpack", 0)
        writer.add_message(channel, 0, bytes(64 << 20), 0, sequence=0)
        writer.flush()
    content = bytearray(path.read_bytes())
    head = content.index(b"\x03\x00\x00\x00lz4") - 12  # size and CRC come before the name of the compression
    content[head : head + 8] = (1000).to_bytes(8, "little")
    path.write_bytes(content)
    with pytest.raises(LogReadError, match="a chunk has more bytes, its head says 1000"):
        data_of(path)
    content[head : head + 8] = (1 << 50).to_bytes(8, "little")
    path.write_bytes(content)
    with pytest.raises(LogReadError, match="a chunk is said to have 1125899906842624 bytes"):
        data_of(path)


def test_json_that_is_nested_too_deep_is_an_error_of_the_log(tmp_path: Path) -> None:
    """Not one of the interpreter."""
    with LogWriter(tmp_path) as log:
        log.write("/event", b"[" * 100_000)
    (message,) = LogReader(tmp_path).messages()
    with pytest.raises(LogReadError, match="message 0 of /event is not JSON"):
        message.json()
