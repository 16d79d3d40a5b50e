"""Real runs of `reskpn train`, as processes on loopback, small enough for a test."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from common.log.reader import LogReader

ENVS, STEPS, ACTORS = 32, 8, 2
BATCH = ENVS * STEPS
TICK = threading.Event()
"""Never set: what is waited for is another process's doing, seen in its log."""

SMALL = [
    "--num-envs", str(ENVS),
    "--num-steps", str(STEPS),
    "--actors", str(ACTORS),
    "--algorithm.minibatches", "4",
    "--algorithm.epochs", "2",
    "--algorithm.hidden", "[16, 16]",
    "--episode-length", "40",
    "--physics", "native",
    "--log.checkpoint-every", "5",
]  # fmt: skip


@dataclass
class Training:
    """A `reskpn train` process and its run directory."""

    process: subprocess.Popen[str]
    run_dir: Path

    def finish(self, timeout_s: float = 240.0) -> tuple[int, str]:
        """The exit code, and all that was printed."""
        output, _ = self.process.communicate(timeout=timeout_s)
        return self.process.returncode, output

    @property
    def summary(self) -> dict[str, object]:
        content: dict[str, object] = json.loads((self.run_dir / "summary.json").read_text())
        return content

    def updates(self) -> list[dict[str, object]]:
        """The `/update` messages in the log by now; none where there is no log yet."""
        if not list((self.run_dir / "log").glob("*.mcap")):
            return []
        return [message.json() for message in LogReader(self.run_dir).messages(["/update"])]

    def wait_for(self, condition: Callable[[], object], deadline_s: float = 240.0) -> None:
        """Until the condition holds; the process must be alive meanwhile."""
        end = time.monotonic() + deadline_s
        while not condition():
            assert self.process.poll() is None, f"the run ended first: {self.process.communicate()[0]}"
            assert time.monotonic() < end, "deadline passed"
            TICK.wait(0.05)

    def children(self) -> dict[str, list[int]]:
        """Process ids of this run's services by command: {"learner": [...], "actor": [...]}."""
        found: dict[str, list[int]] = {"learner": [], "actor": []}
        listing = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text()
        for pid in map(int, listing.split()):
            words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            for command in found:
                if command.encode() in words:
                    found[command].append(pid)
        return found


@contextmanager
def small_run(run_dir: Path, *options: str, updates: int = 12) -> Iterator[Training]:
    """A small run of so many updates, begun; it does not outlive the test."""
    command = [sys.executable, "-m", "reskpn", "train", "--run-dir", str(run_dir), *SMALL]
    command += ["--total-steps", str(BATCH * updates), "--evaluation.episodes", "32", *options]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RESKPN_")}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, cwd=run_dir.parent
    )
    try:
        yield Training(process, run_dir)
    finally:
        # Its services stop by themselves when their supervisor is gone.
        process.kill()
        process.communicate()
