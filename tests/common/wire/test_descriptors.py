"""File descriptors: the limit is raised, and sessions leave enough for the log."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from common.errors import SessionError
from common.log.failures import write_failure
from common.wire.descriptors import FEWEST_SESSIONS, MOST_SESSIONS, RESERVED, max_sessions, raise_descriptor_limit
from common.wire.endpoint import free_port
from common.wire.session import open_session


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


IDLE = """
import resource, sys
from pathlib import Path
import numpy as np
resource.setrlimit(resource.RLIMIT_NOFILE, (200, 276))
from common.log.writer import LogWriter
from common.wire.messages import Snapshot, digest_arrays
from common.wire.session import open_session
from services.learner.training.checkpoints import write_checkpoint
with open_session(listen=[sys.argv[1]], max_message_size=1 << 20):
    print("listening", flush=True)
    sys.stdin.readline()
    folder, arrays = Path(sys.argv[2]), {"w": np.zeros(4)}
    with LogWriter(folder / "log", segment_messages=1) as log:
        for _ in range(20):
            log.write("/event", {"level": "info", "name": "x", "text": "y"})
            log.flush(10.0)
    write_checkpoint(folder, Snapshot("r", 1, digest_arrays(arrays), arrays))
    print("written", flush=True)
"""


def test_idle_sessions_leave_room_for_the_log(tmp_path: Path) -> None:
    """Of 276 descriptors, to which a soft limit of 200 is raised, sessions get 20: one more is refused, and the process
    that listens rolls its log and keeps a checkpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        subprocess.Popen(
            [sys.executable, "-c", IDLE, endpoint, str(tmp_path)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        ) as process,
        ExitStack() as idle,
    ):  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "listening\n"
        for _ in range(max_sessions(276)):
            idle.enter_context(open_session(connect=[endpoint], connect_timeout_s=15.0, max_message_size=1 << 20))
        with pytest.raises(SessionError, match="no connection to"):
            open_session(connect=[endpoint], connect_timeout_s=0.5, max_message_size=1 << 20)
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.stdout.readline() == "written\n"
    assert process.returncode == 0
