"""The files of a log: `<run directory>/log/00000.mcap, 00001.mcap, ...`, in order and without a gap."""

from __future__ import annotations

import os
import re
from pathlib import Path

from common.errors import LogReadError
from common.files import is_plain_directory

LOG_DIRECTORY = "log"
_NAME = re.compile(r"(\d{5,})\.mcap")


def segment_path(directory: Path, number: int) -> Path:
    return directory / f"{number:05d}.mcap"


def segment_number(path: Path) -> int | None:
    """The number in a segment's name; None for a file that is not one."""
    match = _NAME.fullmatch(path.name)
    return int(match.group(1)) if match else None


def list_segments(directory: Path) -> list[Path]:
    """The segments in `directory` in the order they were written; empty where there are none.

    Raises:
        LogReadError: the directory cannot be read, or is a symbolic link.
    """
    try:
        if directory.is_symlink():
            raise LogReadError(f"{directory} is a symbolic link, which is not followed in a run directory")
        return _list(directory) if is_plain_directory(directory) else []
    except OSError as error:
        raise unreadable(directory, error) from None


def find_segments(path: Path) -> list[Path]:
    """The segments of `path`, which is a run directory, its log directory or one file.

    Raises:
        LogReadError: there is nothing there, it cannot be read, or a segment between two others is missing.
    """
    try:
        if path.is_file():
            return [path]
        if not path.exists():
            raise LogReadError(f"{path} does not exist; give a run directory, its log directory or an .mcap file")
        # The path itself may be a link: its user chose it. Those within it were chosen by others.
        segments = _list(path) if path.is_dir() else []
    except OSError as error:
        raise unreadable(path, error) from None
    segments = segments or list_segments(path / LOG_DIRECTORY)
    if not segments:
        raise LogReadError(
            f"no log in {path}: neither it nor its folder {LOG_DIRECTORY!r} holds a 00000.mcap; give a run "
            "directory, its log directory or an .mcap file"
        )
    _check_without_gap(segments)
    return segments


def unreadable(path: Path, error: OSError) -> LogReadError:
    """The error to raise for `error`, which occurred while `path` was read."""
    return LogReadError(f"{path} cannot be read: {error.strerror or error}; check its permissions and the disk")


def _list(directory: Path) -> list[Path]:
    numbered = [(number, path) for path in directory.iterdir() if (number := segment_number(path)) is not None]
    return [path for _, path in sorted(numbered)]


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


def sync_directory(directory: Path) -> None:
    """Make the names of the files in `directory` survive a loss of power."""
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
