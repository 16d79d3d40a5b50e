"""Allocator settings for a process that handles large messages continuously."""

from __future__ import annotations

import ctypes
import os

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's `mallopt`."""

_KEPT_BYTES = 256 << 20
"""Free memory at the end of the heap that is not returned to the system."""

_LARGEST_BYTES = 32 << 20
"""Blocks up to this size are allocated on the heap: the largest threshold that glibc accepts."""

CHOSEN_BY_USER = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES")


def keep_large_blocks() -> bool:
    """Make glibc reuse the memory of freed messages instead of returning it to the system.

    By default glibc maps every large block separately, and the system clears each page on its first write; for a
    message that is copied a few times that costs more than the copies. Returns True on success; False if the
    environment configures the allocator or the C library has no `mallopt`.
    """
    if any(name in os.environ for name in CHOSEN_BY_USER):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _LARGEST_BYTES) and mallopt(_TRIM_THRESHOLD, _KEPT_BYTES))
