"""The lock of a log: one process tree at a time reads it to resume the run, repairs it and writes it."""

from __future__ import annotations

import errno
import fcntl
import os
import platform
from pathlib import Path
from types import TracebackType

from common.errors import LogWriteError
from common.files import is_plain_directory, open_in_place
from common.log.failures import write_failure

LOCK = ".lock"
"""Name of the lock file in the directory of the log."""


class LogLock:
    """Held from construction to `release`; the system releases it when the last process that holds it ends.

    A child process that was given the descriptor `fd` holds the same lock, and takes it over by `inherited`.

    Raises:
        LogWriteError: another process holds it, or the directory or the lock file cannot be made.
    """

    def __init__(self, directory: Path, *, inherited: int | None = None) -> None:
        self._directory = directory
        self._fd = -1
        try:
            directory.mkdir(parents=True, exist_ok=True)
            if not is_plain_directory(directory):
                raise OSError(errno.ELOOP, "it is a symbolic link, which is not followed in a run directory")
            self._fd = open_in_place(directory / LOCK, os.O_RDWR)
            if inherited is not None:
                self._take_over(inherited)
            self._lock()
        except OSError as error:
            self.release()
            raise write_failure(directory, error) from error
        except BaseException:
            self.release()
            raise
        if inherited is None:
            os.ftruncate(self._fd, 0)
            os.pwrite(self._fd, f"{os.getpid()} {platform.node()}\n".encode(), 0)

    @property
    def fd(self) -> int:
        """Descriptor to hand to a child process."""
        return self._fd

    def release(self) -> None:
        """Let another process have it. A second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> LogLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def _take_over(self, fd: int) -> None:
        # A lock belongs to the open file: only the very descriptor of the parent is one with its lock.
        given, own = os.fstat(fd), os.fstat(self._fd)
        if (given.st_dev, given.st_ino) != (own.st_dev, own.st_ino):
            raise OSError(errno.EBADF, "the lock that was handed over is of another log")
        os.close(self._fd)
        self._fd = fd
        os.set_inheritable(fd, False)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.pread(self._fd, 300, 0).decode(errors="replace").split()
            pid, host = (*holder, "unknown", "unknown")[:2]
            raise LogWriteError(
                f"the log {self._directory} is being written by another process (pid {pid} on host {host}); a run has "
                "one learner: stop that one, or choose another run directory"
            ) from error
