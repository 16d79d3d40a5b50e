"""Runs that are killed and resumed, and what their logs must say afterwards."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

from common.errors import SessionError
from common.log.reader import LogReader
from common.wire.endpoint import free_port
from common.wire.report import RunReport
from common.wire.rollout import Rollout
from common.wire.status_request import ask, connect
from tests.chaos import faulty

SEED = int(os.environ.get("CHAOS_SEED", secrets.randbelow(10**6)))
"""Decides when runs are killed that may be killed at any time."""

LONGEST_DELAY_S = 0.1
"""After an update that was waited for: a few updates, so that log, checkpoint and snapshot are hit, too."""

PAUSE_S = 0.002
DEADLINE_S = 240.0


def small_options(updates: int, episodes: int = 0) -> list[str]:
    """Two actors with four inverted pendulums each, eight steps a rollout; a checkpoint every fifth version.

    `episodes`: of the evaluation at the end.
    """
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
        "evaluation.episodes": episodes,
    }
    return [word for name, value in options.items() for word in (f"--{name}", str(value))]


UPDATES = 60
OPTIONS = small_options(UPDATES)
"""Of the run whose digests the fixture `undisturbed` has."""


FORKS = multiprocessing.get_context("forkserver")
"""Learners and actors are forked from a process that has loaded JAX and all else, and has computed nothing yet."""

FORKS.set_forkserver_preload(["tests.chaos.loaded"])


class Process:
    """One process of the program and what it prints."""

    words: Path

    @property
    def pid(self) -> int:
        raise NotImplementedError

    def ended(self, timeout_s: float = 0.0) -> int | None:
        """The exit code, below 0 for a signal; None where it still runs after the time."""
        raise NotImplementedError

    def kill(self) -> None:
        """SIGKILL to it and to its children at once, and wait until none of them runs. Nothing where it has ended."""
        if self.ended() is not None:
            return
        children = self.children()
        for pid in (self.pid, *children):
            with contextlib.suppress(ProcessLookupError):  # it may just have ended by itself
                os.kill(pid, signal.SIGKILL)
        self.ended(DEADLINE_S)
        wait_for(lambda: not any(map(runs, children)))

    def kill_an_actor(self) -> None:
        """SIGKILL to one of the actors that it supervises."""
        words = {pid: Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0") for pid in self.children()}
        os.kill(next(pid for pid, said in words.items() if b"actor" in said), signal.SIGKILL)

    def children(self) -> list[int]:
        try:
            listed = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text()
        except (FileNotFoundError, ProcessLookupError):
            return []
        return [int(pid) for pid in listed.split()]

    def printed(self) -> str:
        """All that it has printed by now."""
        return self.words.read_text()

    def end(self, code: int = 0) -> str:
        """What it printed, once it has ended by itself with that exit code."""
        found = self.ended(DEADLINE_S)
        assert found == code, f"exit code {found}: {self.printed()}"
        return self.printed()

    def die(self) -> str:
        """What it printed, once it has killed itself where its fault says so."""
        printed = self.end(-signal.SIGKILL)
        assert "fault: dies" in printed, printed
        return printed


@dataclass
class Command(Process):
    """`reskpn`, as a person starts it."""

    popen: subprocess.Popen[bytes]
    words: Path

    @property
    def pid(self) -> int:
        return self.popen.pid

    def ended(self, timeout_s: float = 0.0) -> int | None:
        try:
            return self.popen.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None


@dataclass
class Fork(Process):
    """A learner or an actor that needed to load nothing, and may have faults in it."""

    process: BaseProcess
    words: Path

    @property
    def pid(self) -> int:
        assert self.process.pid is not None
        return self.process.pid

    def ended(self, timeout_s: float = 0.0) -> int | None:
        self.process.join(timeout_s)
        return self.process.exitcode


class Processes:
    """Starts processes that do not outlive the test."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._stack = ExitStack()
        self._count = 0

    def start(self, *words: object) -> Process:
        """`reskpn` with those words."""
        printed = self._next_file()
        environment = {name: value for name, value in os.environ.items() if not name.startswith("RESKPN_")}
        with printed.open("wb") as output:
            popen = subprocess.Popen(
                [sys.executable, "-m", "reskpn", *map(str, words)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
            )
        return self._watched(Command(popen, printed))

    def fork(self, *words: object, faults: Sequence[str] = ()) -> Process:
        """The same, sooner, with the faults in it that `tests/chaos/faulty.py` lists."""
        printed = self._next_file()
        printed.touch()
        process = FORKS.Process(target=faulty.run, args=(list(map(str, words)), list(faults), str(printed)))
        process.start()
        return self._watched(Fork(process, printed))

    def _next_file(self) -> Path:
        self._count += 1
        return self._folder / f"process-{self._count}.txt"

    def _watched(self, process: Process) -> Process:
        self._stack.callback(process.kill)
        return process

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


def wait_for(condition: Callable[[], object], alive: Sequence[Process] = (), pause_s: float = PAUSE_S) -> None:
    """Until the condition holds; fails where one of `alive` ends first. Asked again after `pause_s`."""
    end = time.monotonic() + DEADLINE_S
    while not condition():
        for process in alive:
            assert process.ended() is None, f"ended too early: {process.printed()}"
        assert time.monotonic() < end, "deadline passed"
        time.sleep(pause_s)


def updates_seen(run_dir: Path) -> int:
    """Updates that are in the log by now."""
    if not list((run_dir / "log").glob("*.mcap")):
        return 0
    return LogReader(run_dir).counts().get("/update", 0)


def events(run_dir: Path) -> list[str]:
    """Names of the events in the log, in their order."""
    return [message.json()["name"] for message in LogReader(run_dir).messages(["/event"])]


def summary(run_dir: Path) -> dict[str, object]:
    content: dict[str, object] = json.loads((run_dir / "summary.json").read_text())
    return content


def train_until(
    started: Processes, run_dir: Path, options: Sequence[str], there: Callable[[], object], delay_s: float = 0.0
) -> None:
    """Train with all processes on this machine until the condition and the delay after it; then kill them all."""
    process = started.start("train", *options, "--run-dir", run_dir)
    wait_for(there, [process])
    time.sleep(delay_s)
    process.kill()


class Apart:
    """A learner and two actors that nobody supervises; each may have faults in it."""

    def __init__(
        self,
        started: Processes,
        run_dir: Path,
        options: Sequence[object],
        learner_faults: Sequence[str] = (),
        actor_faults: Sequence[Sequence[str]] = ((), ()),
        actor_words: Sequence[object] = (),
    ) -> None:
        self._started = started
        self._run_dir = run_dir
        self._actor_words = actor_words
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        words = ("learner", *options, "--run-dir", run_dir, "--transport.endpoint", self.endpoint)
        self.learner = started.fork(*words, faults=learner_faults)
        self.actors = [self._actor(faults) for faults in actor_faults]

    def _actor(self, faults: Sequence[str], more: Sequence[object] = ()) -> Process:
        words = ("actor", "--endpoint", self.endpoint, "--threads", 1, *self._actor_words, *more)
        return self._started.fork(*words, faults=faults)

    def add_actor(self, *faults: str, words: Sequence[object] = ()) -> Process:
        self.actors.append(self._actor(faults, words))
        return self.actors[-1]

    def report_once(self, condition: Callable[[RunReport], object]) -> RunReport:
        """What the learner tells of the run (`reskpn status`), the first time that the condition holds."""
        found: list[RunReport] = []

        def there() -> bool:
            with contextlib.suppress(SessionError), connect(self.endpoint) as session:
                while self.learner.ended() is None and not (found and condition(found[-1])):
                    found.append(ask(session, self.endpoint))
                    time.sleep(PAUSE_S)
            return bool(found and condition(found[-1]))

        wait_for(there, [self.learner])
        return found[-1]

    def lose_actors(self) -> None:
        for actor in self.actors:
            actor.kill()
        self.actors = []

    def kill_learner(self, there: Callable[[], object], delay_s: float = 0.0) -> None:
        wait_for(there, [self.learner, *self.actors])
        time.sleep(delay_s)
        self.learner.kill()

    def resume_learner(self, *faults: str) -> None:
        """On the endpoint that it had, which its settings know."""
        self.learner = self._started.fork("learner", "--resume", self._run_dir, faults=faults)

    def end(self) -> str:
        """What the learner printed, once all have ended well."""
        printed = self.learner.end()
        for actor in self.actors:
            assert "the run is over" in actor.end()
        return printed


def audited(run_dir: Path, updates: int | None, *, waiting_updates: int = 2) -> list[str]:
    """The state digests of all updates, after a look at every promise that the log can keep or break.

    Each update is there once and in order. Each rollout is there once by its place, before the update that names it,
    and is named by exactly one. An actor counts on only when a rollout was acknowledged: were one lost, its number
    would be missing. Of a run that is not over (`updates` is None) rollouts may wait for `waiting_updates` updates: one
    that is being made or recorded, and the next, which the actors work for meanwhile; in async mode more.
    """
    digests: list[str] = []
    waiting: set[tuple[int, int, int]] = set()
    seen: set[tuple[int, int, int]] = set()
    for message in LogReader(run_dir).messages(["/rollout", "/update"]):
        if message.topic == "/rollout":
            rollout = Rollout.decode(message.data)
            assert rollout.id not in seen, f"logged twice: {rollout.id}"
            assert rollout.seq == 0 or (rollout.slot, rollout.generation, rollout.seq - 1) in seen, "acknowledged, lost"
            seen.add(rollout.id)
            waiting.add(rollout.id)
            continue
        update = message.json()
        assert update["version"] == len(digests) + 1
        used = [(name["slot"], name["generation"], name["seq"]) for name in update["rollouts"]]
        assert len(set(used)) == len(used) == 2
        assert waiting.issuperset(used), "used twice, or before it was logged"
        waiting.difference_update(used)
        digests.append(update["state_digest"])
    if updates is None:
        assert len(waiting) <= 2 * waiting_updates, "acknowledged, never used"
        return digests
    assert len(digests) == updates
    assert not waiting, "acknowledged, never used"
    return digests


def verified(started: Processes, run_dir: Path) -> str:
    """What `reskpn replay --verify` prints; it fails unless every state follows from the log, bit for bit."""
    printed = started.start("replay", run_dir, "--verify").end()
    assert "agree, bit for bit" in printed, printed
    return printed
