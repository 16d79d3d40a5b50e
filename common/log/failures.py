"""The message for a log that cannot be written: where, how much space is free and what to do."""

from __future__ import annotations

import errno
import os
import pwd
import shutil
from pathlib import Path

from common.errors import LogWriteError
from common.remedies import remedy


def write_failure(path: Path, error: OSError) -> LogWriteError:
    """The error to raise for `error`, which occurred while `path` was created or written."""
    smaller = " or lower log.segment_bytes" if error.errno == errno.EFBIG else ""
    return LogWriteError(
        f"the log {path} cannot be written by user {_user()}: {error.strerror or error} ({_free_space(path)}); "
        f"{remedy(error)}{smaller}, then start again with the same run directory: what is in the log is kept"
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
