"""Runs that are killed and resumed, and what their logs must say afterwards."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from common.log.reader import LogReader
from common.wire.endpoint import free_port
from common.wire.messages import Rollout

PAUSE_S = 0.002
DEADLINE_S = 240.0


def small_options(updates: int) -> list[str]:
    """Two actors with four inverted pendulums each, eight steps a rollout; a checkpoint every fifth version."""
    options = {
        "num-envs": 8,
        "num-steps": 8,
        "actors": 2,
        "total-steps": 64 * updates,
        "algorithm.minibatches": 2,
        "algorithm.epochs": 2,
        "algorithm.hidden": "[8, 8]",
        "episode-length": 40,
        "physics": "native",
        "log.checkpoint-every": 5,
        "evaluation.episodes": 0,
    }
    return [word for name, value in options.items() for word in (f"--{name}", str(value))]


@dataclass
class Process:
    """One `reskpn` process and what it prints."""

    popen: subprocess.Popen[bytes]
    words: Path

    def kill(self) -> None:
        """SIGKILL to it and to its children at once, and wait until none of them runs. Nothing where it has ended."""
        if self.popen.poll() is not None:
            return
        children = self.children()
        for pid in (self.popen.pid, *children):
            os.kill(pid, signal.SIGKILL)
        self.popen.wait()
        wait_for(lambda: not any(map(runs, children)))

    def kill_an_actor(self) -> None:
        """SIGKILL to one of the actors that it supervises."""
        words = {pid: Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0") for pid in self.children()}
        os.kill(next(pid for pid, said in words.items() if b"actor" in said), signal.SIGKILL)

    def children(self) -> list[int]:
        return [int(pid) for pid in Path(f"/proc/{self.popen.pid}/task/{self.popen.pid}/children").read_text().split()]

    def end(self) -> str:
        """What it printed, once it has ended by itself and well."""
        code = self.popen.wait(DEADLINE_S)
        printed = self.words.read_text()
        assert code == 0, printed
        return printed


class Processes:
    """Starts processes that do not outlive the test."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._stack = ExitStack()
        self._count = 0

    def start(self, *words: object) -> Process:
        self._count += 1
        printed = self._folder / f"process-{self._count}.txt"
        environment = {name: value for name, value in os.environ.items() if not name.startswith("RESKPN_")}
        with printed.open("wb") as output:
            popen = subprocess.Popen(
                [sys.executable, "-m", "reskpn", *map(str, words)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
            )
        self._stack.callback(popen.wait)
        self._stack.callback(popen.kill)
        return Process(popen, printed)

    def close(self) -> None:
        self._stack.close()


@contextmanager
def processes(folder: Path) -> Iterator[Processes]:
    started = Processes(folder)
    try:
        yield started
    finally:
        started.close()


def runs(pid: int) -> bool:
    """Whether a process is there and not only waits to be buried."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(condition: Callable[[], object], alive: Sequence[Process] = ()) -> None:
    """Until the condition holds; fails where one of `alive` ends first."""
    end = time.monotonic() + DEADLINE_S
    while not condition():
        for process in alive:
            assert process.popen.poll() is None, f"ended too early: {process.words.read_text()}"
        assert time.monotonic() < end, "deadline passed"
        time.sleep(PAUSE_S)


def updates_seen(run_dir: Path) -> int:
    """Updates that are in the log by now."""
    if not list((run_dir / "log").glob("*.mcap")):
        return 0
    return LogReader(run_dir).counts().get("/update", 0)


def train_until(
    started: Processes, run_dir: Path, options: Sequence[str], there: Callable[[], object], delay_s: float = 0.0
) -> None:
    """Train with all processes on this machine until the condition and the delay after it; then kill them all."""
    process = started.start("train", *options, "--run-dir", run_dir)
    wait_for(there, [process])
    time.sleep(delay_s)
    process.kill()


class Apart:
    """A learner and two actors that nobody supervises."""

    def __init__(self, started: Processes, run_dir: Path, options: Sequence[str]) -> None:
        self._started = started
        self._run_dir = run_dir
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.learner = started.start("learner", *options, "--run-dir", run_dir, "--transport.endpoint", endpoint)
        self.actors = [started.start("actor", "--endpoint", endpoint, "--threads", 1) for _ in range(2)]

    def kill_learner(self, there: Callable[[], object], delay_s: float = 0.0) -> None:
        wait_for(there, [self.learner, *self.actors])
        time.sleep(delay_s)
        self.learner.kill()

    def resume_learner(self) -> None:
        """On the endpoint that it had, which its settings know."""
        self.learner = self._started.start("learner", "--resume", self._run_dir)

    def end(self) -> str:
        """What the learner printed, once all have ended well."""
        printed = self.learner.end()
        for actor in self.actors:
            assert "the run is over" in actor.end()
        return printed


def audited(run_dir: Path, updates: int) -> list[str]:
    """The state digests of all updates, after a look at every promise that the log can keep or break.

    Each update is there once and in order. Each rollout is there once by its place, before the update that names it,
    and is named by exactly one. An actor counts on only when a rollout was acknowledged: were one lost, its number
    would be missing.
    """
    digests: list[str] = []
    waiting: set[tuple[int, int, int]] = set()
    seen: set[tuple[int, int, int]] = set()
    for message in LogReader(run_dir).messages(["/rollout", "/update"]):
        if message.topic == "/rollout":
            rollout = Rollout.decode(message.data)
            assert rollout.place not in seen, f"logged twice: {rollout.place}"
            assert rollout.seq == 0 or (rollout.slot, rollout.generation, rollout.seq - 1) in seen, "acknowledged, lost"
            seen.add(rollout.place)
            waiting.add(rollout.place)
            continue
        update = message.json()
        assert update["version"] == len(digests) + 1
        used = [(name["slot"], name["generation"], name["seq"]) for name in update["rollouts"]]
        assert len(set(used)) == len(used) == 2
        assert waiting.issuperset(used), "used twice, or before it was logged"
        waiting.difference_update(used)
        digests.append(update["state_digest"])
    assert len(digests) == updates
    assert not waiting, "acknowledged, never used"
    return digests
