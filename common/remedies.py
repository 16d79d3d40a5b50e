"""Remedies for files that cannot be written, by the cause that the operating system names."""

from __future__ import annotations

import errno

_FREE_SPACE = "free some space or choose a directory on a larger disk"
_PERMISSION = "give this user write permission or choose another directory"
_IN_THE_WAY = "something else is in its place: move that away or choose another directory"
_REMEDIES = {
    errno.ENOSPC: _FREE_SPACE,
    errno.EDQUOT: _FREE_SPACE,
    errno.EFBIG: "raise the limit on file size (ulimit -f)",
    errno.EMFILE: "this process has no file descriptors left: raise the limit on open files (ulimit -n)",
    errno.ENFILE: "the machine has no file descriptors left: end what holds them, or raise fs.file-max",
    errno.EIO: "the disk reports a fault: check it, or choose another directory",
    errno.EACCES: _PERMISSION,
    errno.EPERM: _PERMISSION,
    errno.EROFS: "the file system is read-only: choose another directory",
    errno.ENOENT: "its directory does not exist: make it or choose another directory",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOTDIR: "part of the path is a file: choose another directory",
    errno.ESTALE: "leave the files of a run that goes on alone: what was in it is lost, restore it from a copy",
    errno.EEXIST: _IN_THE_WAY,
    errno.EISDIR: _IN_THE_WAY,
}


def remedy(error: OSError) -> str:
    """The remedy for a write that failed with `error`, as part of a sentence, without a full stop."""
    return _REMEDIES.get(error.errno or 0, "remove the cause or choose another directory")
