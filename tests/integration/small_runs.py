"""Real runs of `reskpn train`, as processes on loopback, small enough for a test."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from common.config.sources import parse_json
from common.log.reader import LogReader
from common.wire.rollout import Rollout
from services.learner.training.trainer import Trainer

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


def used_rollouts(run_dir: Path) -> list[list[Rollout]]:
    """For each update the rollouts it names, out of the log, in its order."""
    rollouts = {}
    updates = []
    for message in LogReader(run_dir).messages(["/rollout", "/update"]):
        if message.topic == "/rollout":
            rollout = Rollout.decode(message.data)
            assert rollout.key not in rollouts, "a rollout is logged once"
            rollouts[rollout.key] = rollout
        else:
            names = [(used["slot"], used["incarnation"], used["seq"]) for used in message.json()["rollouts"]]
            # Written ahead: a rollout is in the log before the update that uses it.
            updates.append([rollouts[name] for name in names])
    assert Counter(rollout.key for update in updates for rollout in update).most_common(1)[0][1] == 1
    return updates


def replayed_digests(run_dir: Path) -> list[str]:
    """The state digests that result from the logged rollouts alone, update by update."""
    settings = parse_json(LogReader(run_dir).metadata()["settings"]["json"])
    trainer = Trainer(settings)
    digests = []
    for rollouts in used_rollouts(run_dir):
        trainer.update(rollouts)
        digests.append(trainer.digest())
    return digests
