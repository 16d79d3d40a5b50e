"""Child processes of `reskpn train`: started out of the terminal's reach, and stopped in good order."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence

from common.config.sources import OTHER_VARIABLES, PREFIX

GRACE_S = 20.0
"""Time that a process has to stop after it was asked to; then it is killed."""


def reskpn_command(name: str) -> list[str]:
    """The beginning of the command line of a `reskpn` command that runs under a supervisor."""
    return [sys.executable, "-m", "reskpn", name, "--supervised"]


def start(
    command: Sequence[str],
    output: int | None = None,
    keep: Sequence[int] = (),
    environment: Mapping[str, str] | None = None,
) -> subprocess.Popen[bytes]:
    """Start a process that stops when its standard input ends, out of reach of the terminal's Ctrl-C.

    `keep`: descriptors that it inherits. `environment`: by default this process's; without settings in any case.
    """
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=output,
        stderr=subprocess.STDOUT if output is not None else None,
        env=_child_environment(os.environ if environment is None else environment),
        start_new_session=True,
        pass_fds=keep,
    )


def ask_to_stop(process: subprocess.Popen[bytes]) -> None:
    """Close the standard input of a supervised process, which stops then."""
    if process.stdin is not None and not process.stdin.closed:
        process.stdin.close()


def stop_all(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    """Ask the processes to stop, wait, and kill those that do not."""
    for process in processes:
        ask_to_stop(process)
    deadline = time.monotonic() + GRACE_S
    for process in processes:
        try:
            process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _child_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment without settings: the child gets them merged, in a file."""
    return {
        name: value for name, value in environment.items() if not name.startswith(PREFIX) or name in OTHER_VARIABLES
    }
