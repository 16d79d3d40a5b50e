"""What is left of a log when its process is killed or its disk is full: exactly what was acknowledged, or more
whole messages after it, and never half of one."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from common.errors import LogWriteError
from common.log.reader import LogReader
from common.log.repair import repair
from common.log.writer import LogWriter

DEADLINE_S = 20.0


def child(code: str, *arguments: str) -> subprocess.Popen[bytes]:
    """A process that runs `code` with this one's import path."""
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )


WRITE_FOR_EVER = """
import sys, itertools
from pathlib import Path
from common.log.writer import LogWriter

log = LogWriter(Path(sys.argv[1]), segment_bytes=20_000_000)
for number in itertools.count():
    data = number.to_bytes(4, "little") * (number * 7919 % 50_000)
    log.write("/rollout", data, on_durable=lambda number=number: print(number, flush=True))
    if number % 16 == 0:
        log.flush(20.0)
"""


def test_a_killed_writer_loses_nothing_it_acknowledged(tmp_path: Path) -> None:
    """SIGKILL at any moment: all acknowledged messages are read back whole and in order, before and after repair."""
    with child(WRITE_FOR_EVER, str(tmp_path)) as process:
        assert process.stdout is not None
        try:
            lines = [process.stdout.readline() for _ in range(300)]
        finally:
            os.kill(process.pid, signal.SIGKILL)
        lines += process.stdout.readlines()
    # a line cut by the kill acknowledges nothing
    acknowledged = [int(line) for line in lines if line.endswith(b"\n")]
    assert len(acknowledged) >= 300
    expected = [number.to_bytes(4, "little") * (number * 7919 % 50_000) for number in range(len(acknowledged) + 500)]

    found = [m.data for m in LogReader(tmp_path).messages()]
    assert len(found) >= len(acknowledged)
    assert found == expected[: len(found)]
    assert len(LogReader(tmp_path).torn) == 1

    report = repair(tmp_path)
    assert len(report.segments) == 1
    assert LogReader(tmp_path).torn == []
    assert [m.data for m in LogReader(tmp_path).messages()] == found


def write_until_it_fails(directory: Path, size: int) -> tuple[list[int], LogWriter, list[LogWriteError]]:
    """Numbered messages of `size` bytes until the log fails; those acknowledged, the log and the reported errors."""
    acknowledged: list[int] = []
    errors: list[LogWriteError] = []
    numbers = itertools.count()
    failed = threading.Event()

    def report(error: LogWriteError) -> None:
        errors.append(error)
        failed.set()

    def write_three() -> None:
        for number in itertools.islice(numbers, 3):
            data = number.to_bytes(4, "little") * (size // 4)
            log.write("/rollout", data, on_durable=partial(acknowledged.append, number))
        log.flush(DEADLINE_S)

    log = LogWriter(directory, on_error=report)
    with contextlib.suppress(LogWriteError):
        for _ in range(300):
            write_three()
    assert failed.wait(DEADLINE_S)
    return acknowledged, log, errors


def test_a_full_disk_ends_the_log_after_what_was_acknowledged(
    small_disk: Path, read_back: Callable[[Path], list[bytes]]
) -> None:
    """Every call says so with path, room and remedy, and the files hold the acknowledged messages and nothing else."""
    acknowledged, log, errors = write_until_it_fails(small_disk / "log", 100_000)
    # 2 MiB hold 20 messages of 100,000 bytes at most, and 18 at least with 6 kB of schemas and groups of 3
    assert 18 <= len(acknowledged) <= 20
    for call in (lambda: log.write("/rollout", b"more"), lambda: log.flush(DEADLINE_S), log.close):
        with pytest.raises(LogWriteError) as caught:
            call()
        sentence = str(caught.value)
        assert str(small_disk / "log" / "00000.mcap") in sentence
        assert "No space left on device" in sentence
        assert "MB of 2.1 MB are free" in sentence
        assert "free some space" in sentence
    assert len(errors) == 1
    found = read_back(small_disk)
    assert [int.from_bytes(data[:4], "little") for data in found] == acknowledged
    assert all(data == data[:4] * 25_000 for data in found)
    assert [torn.dropped_bytes for torn in LogReader(small_disk).torn] == [0]


def test_a_log_that_does_not_fit_from_the_start_leaves_no_file(small_disk: Path) -> None:
    """The constructor raises, and nothing is there that a reader could stumble over."""
    with pytest.raises(LogWriteError, match="No space left on device"):
        LogWriter(small_disk / "log", attachments={"big": ("application/octet-stream", bytes(4_000_000))})
    assert list((small_disk / "log").glob("*.mcap")) == []
    LogWriter(small_disk / "log").close()  # and the lock is free again


WRITE_UP_TO_A_LIMIT = """
import json, resource, sys
from pathlib import Path
from common.errors import LogWriteError
from common.log.writer import LogWriter

resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
acknowledged, error = [], ""
log = LogWriter(Path(sys.argv[1]))
try:
    for number in range(1000):
        data = number.to_bytes(4, "little") * 17_000
        log.write("/rollout", data, on_durable=lambda number=number: acknowledged.append(number))
        if number % 4 == 3:
            log.flush(20.0)
except LogWriteError as caught:
    error = str(caught)
print(json.dumps([acknowledged, error]))
"""


def test_a_limit_on_file_size_ends_the_log_after_what_was_acknowledged(
    tmp_path: Path, read_back: Callable[[Path], list[bytes]]
) -> None:
    """The same as a full disk, with the remedy for this cause."""
    process = child(WRITE_UP_TO_A_LIMIT, str(tmp_path))
    output, _ = process.communicate(timeout=DEADLINE_S)
    acknowledged, error = json.loads(output)
    # groups of 4 messages of 68,000 bytes, in 1,000,000 bytes: 3 groups (816,000) fit, 4 (1,088,000) do not.
    # The last group is split where the thread was quick, so up to 14 (952,000) may be in.
    assert 12 <= len(acknowledged) <= 14
    assert "File too large" in error
    assert "ulimit -f" in error
    assert [int.from_bytes(data[:4], "little") for data in read_back(tmp_path)] == acknowledged


def test_a_segment_that_cannot_be_begun_ends_the_log(tmp_path: Path, read_back: Callable[[Path], list[bytes]]) -> None:
    """The finished segments stay whole, and the message that needed a new one is not acknowledged."""
    acknowledged: list[int] = []
    log = LogWriter(tmp_path, segment_bytes=1)
    log.write("/rollout", b"0", on_durable=lambda: acknowledged.append(0))
    log.flush(DEADLINE_S)
    (tmp_path / "00001.mcap").mkdir()
    log.write("/rollout", b"1", on_durable=lambda: acknowledged.append(1))
    with pytest.raises(LogWriteError, match="File exists"):
        log.flush(DEADLINE_S)
    with pytest.raises(LogWriteError):
        log.close()
    assert acknowledged == [0]
    (tmp_path / "00001.mcap").rmdir()
    assert read_back(tmp_path) == [b"0"]
    assert LogReader(tmp_path).torn == []


@pytest.mark.parametrize("how", ["removed", "folder removed", "cut"])
def test_a_log_that_is_taken_away_ends_the_run(tmp_path: Path, how: str) -> None:
    """With a sentence, not with a run that seems to have finished."""
    log = LogWriter(tmp_path / "log")
    log.write("/rollout", b"one" * 1000)
    log.flush(DEADLINE_S)
    (path,) = (tmp_path / "log").glob("*.mcap")
    if how == "cut":
        os.truncate(path, 100)
    elif how == "removed":
        path.unlink()
    else:
        shutil.rmtree(tmp_path / "log")
    log.write("/rollout", b"two")
    with pytest.raises(LogWriteError, match=r"it was (removed or replaced|changed by another program) while it was wr"):
        log.close()
