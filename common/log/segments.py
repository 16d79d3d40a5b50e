"""The files of a log: `<run directory>/log/00000.mcap, 00001.mcap, ...`, and the lock of their one writer."""

from __future__ import annotations

import fcntl
import os
import re
from pathlib import Path
from types import TracebackType

from common.errors import LogReadError, LogWriteError

LOG_DIRECTORY = "log"
_NAME = re.compile(r"(\d{5,})\.mcap")
_LOCK = ".lock"


def segment_path(directory: Path, number: int) -> Path:
    return directory / f"{number:05d}.mcap"


def segment_number(path: Path) -> int | None:
    """The number in a segment's name; None for a file that is not one."""
    match = _NAME.fullmatch(path.name)
    return int(match.group(1)) if match else None


def list_segments(directory: Path) -> list[Path]:
    """The segments in `directory` in the order they were written; empty where there are none."""
    if not directory.is_dir():
        return []
    numbered = [(number, path) for path in directory.iterdir() if (number := segment_number(path)) is not None]
    return [path for _, path in sorted(numbered)]


def find_segments(path: Path) -> list[Path]:
    """The segments of `path`, which is a run directory, its log directory or one file.

    Raises:
        LogReadError: there is nothing there, or a segment between two others is missing.
    """
    if path.is_file():
        return [path]
    if not path.exists():
        raise LogReadError(f"{path} does not exist; give a run directory, its log directory or an .mcap file")
    segments = list_segments(path) or list_segments(path / LOG_DIRECTORY)
    if not segments:
        raise LogReadError(
            f"no log in {path}: neither it nor its folder {LOG_DIRECTORY!r} holds a 00000.mcap; give a run "
            "directory, its log directory or an .mcap file"
        )
    _check_without_gap(segments)
    return segments


def _check_without_gap(segments: list[Path]) -> None:
    # A log may lack its beginning, which people delete to save space; with a gap, two halves would pass for one run.
    present = {segment_number(path) for path in segments}
    first, last = segment_number(segments[0]), segment_number(segments[-1])
    assert first is not None
    assert last is not None
    for number in range(first, last):
        if number not in present:
            missing = segment_path(segments[0].parent, number)
            raise LogReadError(f"{missing} is missing between two others; restore it, or read single files")


class WriterLock:
    """Keeps a second process from writing a log; the system drops it when its process ends.

    Raises:
        LogWriteError: another process holds it.
        OSError: the lock file cannot be made.
    """

    def __init__(self, directory: Path) -> None:
        self._fd = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = os.pread(self._fd, 32, 0).decode(errors="replace").strip()
            self.release()
            raise LogWriteError(
                f"the log {directory} is being written by another process (pid {owner or 'unknown'}); a run has one "
                "learner: stop that one, or choose another run directory"
            ) from error
        except OSError:
            self.release()
            raise
        os.ftruncate(self._fd, 0)
        os.pwrite(self._fd, f"{os.getpid()}\n".encode(), 0)

    def release(self) -> None:
        """Let another process write. A second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> WriterLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def sync_directory(directory: Path) -> None:
    """Make the names of the files in `directory` survive a loss of power."""
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
