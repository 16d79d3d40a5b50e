"""The processes that make runs (`reskpn.study.one_run`), from the side of the one who starts them."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from common.config.settings import RunSettings
from common.errors import ProcessError
from reskpn.study.running import Work, check_exit

COMMAND = (sys.executable, "-m", "reskpn.study.one_run")


class RunProcess:
    """A process that makes one run after another, and ends with the first that fails."""

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._errors: list[str] = []
        self._reader = threading.Thread(target=self._errors.extend, args=(self._process.stderr,))
        self._reader.start()

    def make(self, settings: RunSettings, path: Path, work: Work) -> None:
        """Make one run; the result is written to `path`.

        Raises:
            LogWriteError: the result could not be written.
            ProcessError: the run failed. After either error the process has ended.
        """
        work.process = self._process
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended: why is told below
            self._process.stdin.write(json.dumps({"path": str(path), "settings": settings.model_dump_json()}) + "\n")
            self._process.stdin.flush()
        for line in self._process.stdout:
            if not line.startswith("{"):
                continue
            told = json.loads(line)
            if told.get("finished"):
                return
            work.steps = told["update"] * settings.batch_size
        self._reader.join()
        code = self._process.wait()
        check_exit(code, self._errors)
        raise ProcessError(f"its process ended with code {code} before the run was finished")

    def close(self) -> None:
        """Let the process end, and wait for that."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        with self._process:  # closes the pipes and waits
            self._process.stdout.read()
            self._reader.join()


def fresh(settings: RunSettings, path: Path, work: Work) -> None:
    """A runner: each run in a process of its own, which gives its memory back and takes no other run with it."""
    process = RunProcess()
    try:
        process.make(settings, path, work)
    finally:
        process.close()


class Warm:
    """A runner for many small runs, whose processes would take longer to start than to work.

    As many processes as there are runs at a time, each of which makes one run after another.
    """

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        self._command = command
        self._idle: list[RunProcess] = []

    def __call__(self, settings: RunSettings, path: Path, work: Work) -> None:
        process = self._idle.pop() if self._idle else RunProcess(self._command)
        try:
            process.make(settings, path, work)
        except BaseException:
            process.close()
            raise
        self._idle.append(process)

    def close(self) -> None:
        """Let the processes end."""
        while self._idle:
            self._idle.pop().close()
