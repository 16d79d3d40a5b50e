"""File descriptors: every session of another process takes one, and the log must not be left without."""

from __future__ import annotations

import resource

RESERVED = 256
"""Kept free of sessions, for the log, checkpoints, curves, and connections that are still being refused."""

MOST_SESSIONS = 1000
FEWEST_SESSIONS = 16


def raise_descriptor_limit() -> int:
    """Raise this process's soft limit on open files to its hard one (65,536 at most); returns the limit then."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 65_536 if hard == resource.RLIM_INFINITY else min(hard, 65_536)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        soft = wanted
    return wanted if soft == resource.RLIM_INFINITY else soft


def max_sessions(limit: int) -> int:
    """The number of sessions to accept where `limit` files may be open."""
    return max(FEWEST_SESSIONS, min(MOST_SESSIONS, limit - RESERVED))
