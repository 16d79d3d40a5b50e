"""What `LogWriter` promises its callers."""

from __future__ import annotations

import os
import platform
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mcap.reader import make_reader

from common.errors import LogWriteError
from common.log.reader import LogReader
from common.log.records import CHANNELS
from common.log.writer import LogWriter

DEADLINE_S = 20.0


def one_of_each() -> dict[str, bytes | dict[str, Any]]:
    """A message for every channel."""
    return {
        "/spec": {"settings": {"task": "hopper"}, "versions": {"jax": "0.10"}},
        "/rollout": bytes(range(256)) * 40,
        "/update": {
            "version": 1,
            "env_steps": 20480,
            "rollouts": [{"slot": 0, "incarnation": "a1", "seq": 0, "policy_version": 0}],
            "state_digest": "00ff",
            "metrics": {"kl": 0.01},
            "seconds": {"update": 0.3},
            "staleness": {"min": 0, "mean": 0.0, "max": 0},
        },
        "/set_aside": {"version": 1, "rollouts": [{"slot": 0, "incarnation": "a1", "seq": 1}], "reason": "asked for"},
        "/policy": b"\x93\x01\x02\x03",
        "/environment": b"\x81\xa3run",
        "/episode": {"version": 1, "count": 2, "return_mean": 1.5},
        "/event": {"level": "info", "name": "joined", "text": "actor 0 joined", "slot": 0},
        "/eval": {"version": 1, "episodes": 4, "return_mean": 10.0},
        "/trajectory": {"version": 1, "source": "e1", "steps": [{"time_s": 0.5, "qpos": [0.25]}]},
        "/motion": b"\x81\xa3run",
        "/divergence": b"\x81\xa4slot",
        "/seal": {"log_digest": "00"},
    }


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_every_channel_is_read_back_as_it_was_written(tmp_path: Path, compression: Any) -> None:
    """Bytes come back verbatim, JSON as equal content, in the order and with the times given."""
    messages = one_of_each()
    assert set(messages) == set(CHANNELS)
    with LogWriter(tmp_path, compression=compression) as log:
        for t_ns, (topic, data) in enumerate(messages.items()):
            log.write(topic, data, t_ns=1000 - t_ns)
    found = list(LogReader(tmp_path).messages())
    # times run backwards on purpose: the order is that of the writes, not of the times
    assert [(m.topic, m.t_ns, m.sequence) for m in found] == [
        (topic, 1000 - number, number) for number, topic in enumerate(messages)
    ]
    for message in found:
        sent = messages[message.topic]
        assert (message.data if isinstance(sent, bytes) else message.json()) == sent
    assert LogReader(tmp_path).counts() == dict.fromkeys(CHANNELS, 1)


def test_messages_without_a_time_get_that_of_the_clock(tmp_path: Path) -> None:
    """The clock is asked when a message is written, not when the thread comes to it."""
    times = iter([5, 7, 11])  # 5 is for the start of the segment
    with LogWriter(tmp_path, clock_ns=lambda: next(times)) as log:
        log.write("/rollout", b"a")
        log.write("/rollout", b"b")
    assert [m.t_ns for m in LogReader(tmp_path).messages()] == [7, 11]


def test_segments_roll_and_each_is_a_whole_mcap_file(tmp_path: Path, write_log: Callable[..., Path]) -> None:
    """Any MCAP program reads any segment alone: summary, schemas, metadata; attachments are in the first."""
    sizes = [40_000] * 6
    # a segment is left once it has reached 100,000 bytes: after 3 messages (and some 5 kB of schemas)
    write_log(tmp_path, sizes, segment_bytes=100_000)
    segments = sorted(tmp_path.glob("*.mcap"))
    assert [path.name for path in segments] == ["00000.mcap", "00001.mcap"]
    for number, path in enumerate(segments):
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert [(c.topic, len(m.data)) for _, c, m in reader.iter_messages()] == [("/rollout", 40_000)] * 3
            summary = reader.get_summary()
            assert summary is not None
            assert {c.topic for c in summary.channels.values()} == set(CHANNELS)
            encodings = {s.name: s.encoding for s in summary.schemas.values()}
            assert encodings["reskpn.update"] == "jsonschema"
            assert [(m.name, m.metadata["python"]) for m in reader.iter_metadata() if m.name == "versions"] == [
                ("versions", "3.11")
            ]
            assert [a.name for a in reader.iter_attachments()] == ([] if number else ["model.xml"])
    assert [int.from_bytes(m.data[:4], "little") for m in LogReader(tmp_path).messages()] == list(range(6))


def test_acknowledged_means_that_a_reader_finds_it(tmp_path: Path) -> None:
    """`on_durable` comes after the bytes are in the file, in the order of the writes, from the writer's thread."""
    seen: list[tuple[int, list[bytes], str]] = []

    def check(number: int) -> None:
        found = [m.data for m in LogReader(tmp_path).messages()]
        seen.append((number, found[: number + 1], threading.current_thread().name))

    with LogWriter(tmp_path) as log:
        for number in range(20):
            log.write("/rollout", b"%d" % number, on_durable=partial(check, number))
        log.flush(DEADLINE_S)
        expected = [b"%d" % number for number in range(20)]
        assert seen == [(number, expected[: number + 1], "log-writer") for number in range(20)]


class Gate:
    """Holds the writer's thread in an acknowledgement until it is opened."""

    def __init__(self) -> None:
        self.reached = threading.Event()
        self.open = threading.Event()

    def __call__(self) -> None:
        self.reached.set()
        assert self.open.wait(DEADLINE_S)


def test_pending_bytes_are_those_not_in_the_file(tmp_path: Path) -> None:
    """What callers bound their queue by: written bytes leave it, queued ones stay."""
    gate = Gate()
    with LogWriter(tmp_path) as log:
        log.write("/rollout", bytes(500), on_durable=gate)
        assert gate.reached.wait(DEADLINE_S)
        assert log.pending_bytes == 0  # the 500 are in the file; the thread is held behind that
        for _ in range(3):
            log.write("/rollout", bytes(1000))
        assert log.pending_bytes == 3000
        gate.open.set()
        log.flush(DEADLINE_S)
        assert log.pending_bytes == 0


def test_flush_gives_up_at_its_deadline(tmp_path: Path) -> None:
    """A stuck disk must not hold the caller for ever, and the sentence says how much waits."""
    gate = Gate()
    with LogWriter(tmp_path) as log:
        log.write("/rollout", b"", on_durable=gate)
        assert gate.reached.wait(DEADLINE_S)
        log.write("/rollout", bytes(1234))
        with pytest.raises(LogWriteError, match=r"not written within 0\.01 s: 1234 bytes"):
            log.flush(0.01)
        gate.open.set()


def test_busy_seconds_are_those_of_the_thread_at_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a run's time is broken down by: commits, acknowledgements and syncs count, waiting for work does not."""
    clock_s = [0.0]

    def takes(seconds: float) -> Callable[[], None]:
        return lambda: clock_s.__setitem__(0, clock_s[0] + seconds)

    for module in ("writer", "segment_sequence"):
        monkeypatch.setattr(f"common.log.{module}.time", SimpleNamespace(monotonic=lambda: clock_s[0]))
    monkeypatch.setattr(os, "fdatasync", lambda fd: takes(2.0)())
    with LogWriter(tmp_path, sync_period_s=200.0) as log:
        assert log.busy_s == 0.0
        log.write("/rollout", b"a", on_durable=takes(5.0))
        log.flush(DEADLINE_S)
        assert log.busy_s == 5.0
        takes(100.0)()  # idle; no sync is due before 200
        log.write("/rollout", b"b", on_durable=takes(3.0))
        log.flush(DEADLINE_S)
        assert log.busy_s == 8.0  # 5 + 3
        log.write("/rollout", b"c", on_durable=takes(100.0))  # the clock passes 200: the thread syncs, for 2
        log.flush(DEADLINE_S)
    assert log.busy_s == 110.0  # 8 + 100 + 2; finishing the file at the close is the end of the run, not its work


def count_syncs(monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], threading.Event]:
    """Counts the syncs of files from here on."""
    real, syncs, happened = os.fdatasync, [], threading.Event()

    def counted(fd: int) -> None:
        real(fd)
        syncs.append(fd)
        happened.set()

    monkeypatch.setattr(os, "fdatasync", counted)
    return syncs, happened


def test_syncs_are_no_more_frequent_than_the_period(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commits do not wait for the disk: within a period there is none, at the close exactly one."""
    syncs, _ = count_syncs(monkeypatch)
    with LogWriter(tmp_path, sync_period_s=3600.0) as log:
        for _ in range(10):
            log.write("/rollout", bytes(100))
            log.flush(DEADLINE_S)
        assert len(syncs) == 0
    assert len(syncs) == 1


def test_the_last_message_before_a_pause_is_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sync that is due comes although nothing more is written."""
    syncs, happened = count_syncs(monkeypatch)
    with LogWriter(tmp_path, sync_period_s=0.02) as log:
        log.write("/rollout", bytes(100))
        assert happened.wait(DEADLINE_S)
        assert len(syncs) == 1


def test_a_second_writer_continues_after_the_first(tmp_path: Path) -> None:
    """A resumed run adds segments; those there are stay byte for byte."""
    with LogWriter(tmp_path, metadata={"versions": {"jax": "1"}}) as log:
        log.write("/rollout", b"first")
    before = (tmp_path / "00000.mcap").read_bytes()
    with LogWriter(tmp_path, metadata={"versions": {"jax": "2"}}) as log:
        log.write("/rollout", b"second")
    assert (tmp_path / "00000.mcap").read_bytes() == before
    reader = LogReader(tmp_path)
    assert [m.data for m in reader.messages()] == [b"first", b"second"]
    assert reader.metadata() == {"versions": {"jax": "2"}}
    assert LogReader(tmp_path / "00000.mcap").metadata() == {"versions": {"jax": "1"}}


def test_two_learners_cannot_write_one_log(tmp_path: Path) -> None:
    """The second is told which process is in its way; after the first has closed, the log is free."""
    with (
        LogWriter(tmp_path),
        pytest.raises(
            LogWriteError, match=rf"written by another process \(pid {os.getpid()} on host {platform.node()}\)"
        ),
    ):
        LogWriter(tmp_path)
    LogWriter(tmp_path).close()


def test_a_directory_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    """The error comes at construction, with path, user and remedy."""
    (tmp_path / "file").write_bytes(b"")
    place = tmp_path / "file" / "log"
    with pytest.raises(LogWriteError) as caught:
        LogWriter(place)
    assert str(place) in str(caught.value)
    assert "by user " in str(caught.value)
    assert "choose another directory" in str(caught.value)


def test_calls_that_make_no_sense_are_refused_at_once(tmp_path: Path) -> None:
    """In the caller's thread, where the mistake is, and the log goes on."""
    log = LogWriter(tmp_path)
    with pytest.raises(LogWriteError, match=r"'/rolout' is not a channel of the log; did you mean '/rollout'"):
        log.write("/rolout", b"")
    with pytest.raises(TypeError, match="msgpack"):
        log.write("/rollout", {"seq": 1})
    with pytest.raises(TypeError, match="give a mapping"):
        log.write("/event", "text")  # type: ignore[arg-type]
    log.write("/rollout", b"good")
    log.close()
    log.close()
    with pytest.raises(LogWriteError, match="is closed"):
        log.write("/rollout", b"late")
    assert [m.data for m in LogReader(tmp_path).messages()] == [b"good"]


def test_a_segment_holds_a_message_whatever_it_begins_with(tmp_path: Path) -> None:
    """Attachments larger than a segment may be do not make an empty one."""
    with LogWriter(tmp_path, segment_bytes=1000, attachments={"big": ("text/plain", bytes(5000))}) as log:
        log.write("/rollout", b"one")
        log.flush(DEADLINE_S)
        log.write("/rollout", b"two")
    assert [LogReader(tmp_path / name).counts() for name in ("00000.mcap", "00001.mcap")] == [{"/rollout": 1}] * 2


def test_many_small_messages_roll_segments_too(tmp_path: Path) -> None:
    """What mcap keeps in memory for a segment, an index of its chunks, has a bound whatever the size of messages."""
    with LogWriter(tmp_path, segment_messages=10) as log:
        for number in range(25):
            log.write("/rollout", bytes([number]))
            log.flush(DEADLINE_S)
    segments = sorted(tmp_path.glob("*.mcap"))
    assert [LogReader(path).counts() for path in segments] == [{"/rollout": count} for count in (10, 10, 5)]
    assert [message.data[0] for message in LogReader(tmp_path).messages()] == list(range(25))


def test_an_acknowledgement_that_raises_ends_the_log(tmp_path: Path) -> None:
    """A broken caller is reported like a broken disk: once to `on_error`, then at every call."""
    errors: list[LogWriteError] = []
    failed = threading.Event()

    def broken() -> None:
        raise KeyError("slot 3")

    def report(error: LogWriteError) -> None:
        errors.append(error)
        failed.set()

    log = LogWriter(tmp_path, on_error=report)
    log.write("/rollout", b"one", on_durable=broken)
    assert failed.wait(DEADLINE_S)
    for call in (lambda: log.write("/rollout", b"two"), lambda: log.flush(DEADLINE_S), log.close):
        with pytest.raises(LogWriteError, match="slot 3"):
            call()
    assert len(errors) == 1


def test_an_error_in_the_block_is_not_hidden_by_the_log(tmp_path: Path) -> None:
    """Of two errors the one that came first is seen, and the file is finished all the same."""

    def divide() -> None:
        with LogWriter(tmp_path) as log:
            log.write("/rollout", b"before")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        divide()
    assert [m.data for m in LogReader(tmp_path).messages()] == [b"before"]
    assert LogReader(tmp_path).torn == []
