"""The lock of a log: one process tree at a time."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from common.errors import LogWriteError
from common.log.lock import LOCK, LogLock
from common.log.repair import repair
from common.log.writer import LogWriter

TAKE = """
import sys
from pathlib import Path
from common.errors import LogWriteError
from common.log.lock import LogLock
try:
    LogLock(Path(sys.argv[1]), inherited=int(sys.argv[2]) if sys.argv[2:] else None)
except LogWriteError as error:
    sys.exit(str(error))
"""


def take(directory: Path, *inherited: int) -> subprocess.CompletedProcess[str]:
    """Take the lock in a child process, which was given these descriptors."""
    words = [sys.executable, "-c", TAKE, str(directory), *map(str, inherited)]
    return subprocess.run(words, pass_fds=inherited, capture_output=True, text=True, timeout=60)


def test_another_process_is_told_who_holds_it(tmp_path: Path) -> None:
    """With process and host; it is free when it was released."""
    with LogLock(tmp_path):
        refused = take(tmp_path)
        assert refused.returncode == 1
        assert f"(pid {os.getpid()} on host {platform.node()})" in refused.stderr
    assert take(tmp_path).returncode == 0


def test_a_child_shares_the_lock_of_its_parent(tmp_path: Path) -> None:
    """Through the parent's descriptor; the parent holds it all the while, and goes on holding it."""
    with LogLock(tmp_path) as lock:
        assert take(tmp_path, lock.fd).returncode == 0
        assert take(tmp_path).returncode == 1


def test_a_descriptor_of_something_else_is_no_lock(tmp_path: Path) -> None:
    """A child that was given the lock of another log is refused."""
    with LogLock(tmp_path / "other") as other:
        refused = take(tmp_path, other.fd)
    assert refused.returncode == 1
    assert "the lock that was handed over is of another log" in refused.stderr


def test_repair_and_writer_work_under_the_callers_lock(tmp_path: Path) -> None:
    """From the first read to the last write nobody else can come in between: the lock is never let go."""
    LogWriter(tmp_path).close()
    with LogLock(tmp_path) as lock:
        repair(tmp_path, lock)
        assert take(tmp_path).returncode == 1
        with LogWriter(tmp_path, lock=lock) as log:
            log.write("/rollout", b"one")
        assert take(tmp_path).returncode == 1
        with pytest.raises(LogWriteError, match="being written by another process"):
            repair(tmp_path)
    assert take(tmp_path).returncode == 0


def test_a_lock_file_that_is_a_link_is_not_opened(tmp_path: Path) -> None:
    """What it points to would be emptied."""
    victim = tmp_path / "victim"
    victim.write_text("precious")
    log = tmp_path / "log"
    log.mkdir()
    (log / LOCK).symlink_to(victim)
    with pytest.raises(LogWriteError, match="it is a symbolic link, which is not followed in a run directory"):
        LogLock(log)
    (log / LOCK).unlink()
    os.link(victim, log / LOCK)
    with pytest.raises(LogWriteError, match="it is a hard link, and has another name elsewhere"):
        LogLock(log)
    assert victim.read_text() == "precious"


def test_a_log_directory_that_is_a_link_is_not_locked(tmp_path: Path) -> None:
    """Nothing is made in the directory that it points to."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "log").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(LogWriteError, match="it is a symbolic link"):
        LogLock(tmp_path / "log")
    assert not list((tmp_path / "elsewhere").iterdir())
