"""File descriptors: the limit is raised, and sessions leave enough for the log."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

from common.log.failures import write_failure
from common.wire.descriptors import FEWEST_SESSIONS, MOST_SESSIONS, RESERVED, max_sessions, raise_descriptor_limit


def test_sessions_leave_descriptors_for_the_log() -> None:
    """Of 1,024 descriptors 768; never more than 1,000; with hardly any, still a few."""
    assert max_sessions(1024) == 768 == 1024 - RESERVED
    assert max_sessions(65_536) == MOST_SESSIONS
    assert max_sessions(100) == FEWEST_SESSIONS


def test_the_soft_limit_is_raised() -> None:
    """From 64 to the hard limit, or 65,536, in a process of its own; a limit that is higher is left."""
    program = (
        "import resource; from common.wire.descriptors import raise_descriptor_limit as up\n"
        "hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))\n"
        "print(up(), resource.getrlimit(resource.RLIMIT_NOFILE)[0])"
    )
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    wanted = 65_536 if hard == resource.RLIM_INFINITY else min(hard, 65_536)
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.split() == [str(wanted), str(wanted)]
    assert raise_descriptor_limit() >= wanted or hard < wanted


def test_the_cause_is_named(tmp_path: Path) -> None:
    """Of a log or a checkpoint that cannot be opened for want of descriptors: not the disk's room, nor permissions."""
    for number in (errno.EMFILE, errno.ENFILE):
        error = OSError(number, os.strerror(number))
        assert "file descriptors left" in str(write_failure(tmp_path, error))
