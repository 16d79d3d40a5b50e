"""Files of a run directory that may have come from anywhere: no symbolic link in it is followed.

A run directory that somebody else made could hold links, pipes or devices in the place of its files. Opening them
would read, overwrite or block on something outside the run.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

_FLAGS = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def open_to_read(path: Path, buffering: int = -1) -> BinaryIO:
    """The file opened for reading.

    Raises:
        OSError: it cannot be opened, or is not a regular file; `strerror` says which.
    """
    return os.fdopen(_open(path, os.O_RDONLY), "rb", buffering=buffering)


def read_bytes(path: Path) -> bytes:
    """The content of the file. OSError as `open_to_read`."""
    with open_to_read(path) as file:
        return file.read()


def read_text(path: Path) -> str:
    """The content of the file as UTF-8. OSError as `open_to_read`; UnicodeDecodeError where it is not text."""
    return read_bytes(path).decode()


def open_in_place(path: Path, flags: int) -> int:
    """A descriptor of a file that is changed where it lies, created if need be.

    Raises:
        OSError: it cannot be opened, or is not a regular file of this user that has this one name.
    """
    descriptor = _open(path, flags | os.O_CREAT)
    found = os.fstat(descriptor)
    if found.st_uid != os.geteuid():
        os.close(descriptor)
        raise OSError(errno.EPERM, f"it belongs to the user with number {found.st_uid}", str(path))
    if found.st_nlink > 1:
        os.close(descriptor)
        raise OSError(errno.EMLINK, "it is a hard link, and has another name elsewhere", str(path))
    return descriptor


def create(path: Path) -> BinaryIO:
    """A new file for writing; a file or link that is in its place is removed first."""
    path.unlink(missing_ok=True)
    return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _FLAGS, 0o666), "wb")


def require_plain(run_dir: Path) -> None:
    """Check everything in a run directory before it is written to.

    Raises:
        OSError: an entry is neither a directory nor a regular file, or belongs to another user; `strerror` says which.
    """
    folders = [run_dir]
    while folders:
        with os.scandir(folders.pop()) as scanned:
            entries = list(scanned)
        for entry in entries:
            found = entry.stat(follow_symlinks=False)
            if stat.S_ISDIR(found.st_mode):
                folders.append(Path(entry.path))
            elif not stat.S_ISREG(found.st_mode):
                raise OSError(errno.ELOOP, _refusal(found.st_mode), entry.path)
            if found.st_uid != os.geteuid():
                raise OSError(errno.EPERM, f"it belongs to the user with number {found.st_uid}", entry.path)


def is_plain_directory(path: Path) -> bool:
    """True for a directory; False for anything else, a symbolic link to one among it."""
    try:
        return stat.S_ISDIR(path.lstat().st_mode)
    except FileNotFoundError:
        return False


def _open(path: Path, flags: int) -> int:
    try:
        descriptor = os.open(path, flags | _FLAGS, 0o644)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(errno.ELOOP, _refusal(stat.S_IFLNK), str(path)) from None
        raise
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, _refusal(mode), str(path))
    return descriptor


def _refusal(mode: int) -> str:
    if stat.S_ISLNK(mode):
        return "it is a symbolic link, which is not followed in a run directory"
    return "it is not a regular file"
