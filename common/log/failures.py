"""The message for a log that cannot be written: where, how much space is free and what to do."""

from __future__ import annotations

import errno
import os
import pwd
import shutil
from pathlib import Path

from common.errors import LogWriteError

_FREE_SPACE = "free some space or move the run directory to a larger disk"
_PERMISSION = "give that user write permission or choose another run directory"
_REMEDIES = {
    errno.ENOSPC: _FREE_SPACE,
    errno.EDQUOT: _FREE_SPACE,
    errno.EFBIG: "raise the limit on file size (ulimit -f) or lower log.segment_bytes",
    errno.EMFILE: "this process has no file descriptors left: raise the limit on open files (ulimit -n)",
    errno.ENFILE: "the machine has no file descriptors left: end what holds them, or raise fs.file-max",
    errno.EIO: "the disk reports a fault: check it, or choose another run directory",
    errno.EACCES: _PERMISSION,
    errno.EPERM: _PERMISSION,
    errno.EROFS: "the file system is read-only: choose another run directory",
    errno.ENOTDIR: "part of the path is a file: choose another run directory",
    errno.ESTALE: "leave the files of a run that goes on alone: what was in it is lost, restore it from a copy",
    errno.EEXIST: "a file is in its place: choose another run directory",
}


def write_failure(path: Path, error: OSError) -> LogWriteError:
    """The error to raise for `error`, which occurred while `path` was created or written."""
    remedy = _REMEDIES.get(error.errno or 0, "remove the cause or choose another run directory")
    return LogWriteError(
        f"the log {path} cannot be written by user {_user()}: {error.strerror or error} ({_free_space(path)}); "
        f"{remedy}, then start again with the same run directory: what is in the log is kept"
    )


def _user() -> str:
    uid = os.geteuid()
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:  # containers often run as a user without a name
        return str(uid)


def _free_space(path: Path) -> str:
    for place in (path, *path.parents):
        try:
            usage = shutil.disk_usage(place)
        except OSError:
            continue
        return f"{usage.free / 1e6:,.1f} MB of {usage.total / 1e6:,.1f} MB are free there"
    return "the free space is unknown"
