"""The allocator of a process that handles large messages all the time."""

from __future__ import annotations

import ctypes
import os

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's `mallopt`."""

_KEPT_BYTES = 256 << 20
"""Free memory at the end of the heap that is kept."""

_LARGEST_BYTES = 32 << 20
"""Blocks up to this size are taken from the heap: the most that glibc allows."""

CHOSEN_BY_USER = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES")


def keep_large_blocks() -> bool:
    """Keep the memory of messages for the next ones, instead of giving it back to the system after each.

    By default glibc maps every large block anew, and the system clears it page by page as it is written; for a
    message that is copied a few times that costs more than the copies. Returns whether it was done: not where the
    environment says how memory is to be kept, nor with another C library.
    """
    if any(name in os.environ for name in CHOSEN_BY_USER):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _LARGEST_BYTES) and mallopt(_TRIM_THRESHOLD, _KEPT_BYTES))
