"""Recovery times: from the loss of an actor to the next update, and to the first use of its replacement.

    python -m benchmarks.recovery --rounds 5
    python -m benchmarks.recovery --task hopper --num-envs 512

A learner and two actors run on this machine. Each round kills one of the actors, waits for the next update,
starts a replacement, and waits until one of its rollouts is used. Other options are settings of
the run.
"""

from __future__ import annotations

import argparse
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.machine import describe, machine
from benchmarks.processes import bare_environment
from common.errors import ProcessError, ReskpnError, SettingsError
from common.log.reader import LogReader
from common.wire.endpoint import free_port
from services.worker.state_file import read_state

GOES_ON_S = 2.0
"""Promised seconds from the detection of a loss to the next update."""

USED_S = 3.0
"""Promised seconds from the end of a new actor's compilation to the first update with one of its rollouts."""

DEADLINE_S = 180.0
POLL_S = 0.1
SETTLED_UPDATES = 20
RUN = {
    "--total-steps": "1000000000",
    "--num-envs": "64",
    "--num-steps": "8",
    "--actors": "2",
    "--physics": "native",
    "--learner": "ppo",
    "--algorithm.minibatches": "4",
    "--algorithm.hidden": "[16,16]",
}


@dataclass(frozen=True)
class Recovery:
    """Seconds of one loss and replacement; `noticed` is from the kill to the learner's event."""

    noticed: float
    goes_on: float
    used: float


@dataclass(frozen=True)
class Timeline:
    """Losses and the actors used by each update, read from a log, in seconds of the learner's wall clock.

    Attributes:
        updates: time of each, in order.
        losses: (time, slot) of each actor that was lost.
        first_used: time of the first update with a rollout of (slot, generation).
    """

    updates: list[float]
    losses: list[tuple[float, int]]
    first_used: dict[tuple[int, int], float]

    @classmethod
    def of(cls, run_dir: Path) -> Timeline:
        found = cls([], [], {})
        for message in LogReader(run_dir).messages(["/update", "/event"]):
            at_s, record = message.t_ns / 1e9, message.json()
            if message.topic == "/update":
                found.updates.append(at_s)
                for used in record["rollouts"]:
                    found.first_used.setdefault((used["slot"], used["generation"]), at_s)
            elif record["name"] == "actor_lost":
                found.losses.append((at_s, int(record["text"].split(":")[0].removeprefix("slot "))))
        return found

    def went_on_s(self, loss: int) -> float | None:
        """Seconds from that loss to the next update; None if there is none yet."""
        lost_s, _ = self.losses[loss]
        later = [at_s for at_s in self.updates if at_s >= lost_s]
        return later[0] - lost_s if later else None


def compiled_at_s(state_file: Path) -> float | None:
    """The time at which an actor's state file first shows that it has compiled; None until then."""
    found = read_state(state_file)
    return found.time_s if found and found.state not in ("starting", "alone", "standing by", "compiling") else None


class Service:
    """A learner and its actors as processes on this machine, which end with this context."""

    def __init__(self, folder: Path, options: Sequence[str]) -> None:
        self._stack = ExitStack()
        self._folder = folder
        self._endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._count = 0
        self.run_dir = folder / "run"
        where = ("--run-dir", str(self.run_dir), "--transport.endpoint", self._endpoint)
        self._learner = self._start("learner", *options, *where)
        self.actors = [self.add_actor() for _ in range(2)]

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        self._count += 1
        with (self._folder / f"process-{self._count}.txt").open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", "reskpn", *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=bare_environment(),
            )
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def add_actor(self) -> tuple[subprocess.Popen[bytes], Path]:
        """Start an actor; returns its process and its state file."""
        state = self._folder / f"state-{self._count}.json"
        words = ("actor", "--endpoint", self._endpoint, "--threads", "1", "--state-file", str(state))
        return self._start(*words), state

    def wait_for(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition. Raises ProcessError after the deadline or if the learner exits."""
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            if self._learner.poll() is not None or time.monotonic() > end_s:
                words = (self._folder / "process-1.txt").read_text().strip().splitlines()[-5:]
                raise ProcessError(f"{what} did not come; the learner's last words:\n" + "\n".join(words))
            time.sleep(POLL_S)

    def timeline(self) -> Timeline:
        """The events logged so far."""
        began = list((self.run_dir / "log").glob("*.mcap"))
        return Timeline.of(self.run_dir) if began else Timeline([], [], {})

    def close(self) -> None:
        self._stack.close()


def one_round(service: Service, number: int) -> Recovery:
    """Kill the older actor and start a replacement. Rounds count from 0."""
    process, _ = service.actors.pop(0)
    killed_s = time.time()
    process.send_signal(signal.SIGKILL)
    service.wait_for(lambda: len(service.timeline().losses) > number, "the loss of an actor")
    service.wait_for(lambda: service.timeline().went_on_s(number) is not None, "an update after a loss")
    lost_s, slot = service.timeline().losses[number]
    generation = 1 + max(given for place, given in service.timeline().first_used if place == slot)
    service.actors.append(service.add_actor())
    _, state = service.actors[-1]
    service.wait_for(lambda: compiled_at_s(state) is not None, "the end of an actor's compiling")
    compiled_s = compiled_at_s(state)
    service.wait_for(lambda: (slot, generation) in service.timeline().first_used, "an update with a new actor")
    timeline = service.timeline()
    went_on_s = timeline.went_on_s(number)
    assert compiled_s is not None
    assert went_on_s is not None
    used_s = timeline.first_used[slot, generation]
    return Recovery(lost_s - killed_s, went_on_s, max(0.0, used_s - compiled_s))


def measure(rounds: int, options: Sequence[str], folder: Path) -> Iterator[Recovery]:
    """Measure `rounds` losses and replacements in one run."""
    service = Service(folder, options)
    try:
        service.wait_for(lambda: len(service.timeline().updates) >= SETTLED_UPDATES, "the first updates")
        for number in range(rounds):
            yield one_round(service, number)
    finally:
        service.close()


def run_options(given: Sequence[str]) -> list[str]:
    """The options of the run; those given take precedence. Raises SettingsError if one has no value."""
    if len(given) % 2:
        raise SettingsError(f"{given[-1]} has no value; give settings as --name value")
    chosen = RUN | dict(zip(given[::2], given[1::2], strict=True))
    return [word for option in chosen.items() for word in option]


def table(found: Sequence[Recovery]) -> Iterator[str]:
    """Median and worst of each value beside the promised one."""
    promised = {"noticed": None, "goes_on": GOES_ON_S, "used": USED_S}
    says = {
        "noticed": "killed, noticed",
        "goes_on": "noticed, the next update",
        "used": "compiled, used in an update",
    }
    for name, limit in promised.items():
        seconds = [getattr(one, name) for one in found]
        verdict = "" if limit is None else f"  promised {limit:g} s: {'met' if max(seconds) <= limit else 'NOT met'}"
        yield f"{says[name]:28} median {statistics.median(seconds):6.3f} s  worst {max(seconds):6.3f} s{verdict}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recovery", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rounds", type=int, default=5, help="losses and returns (default: 5)")
    parser.add_argument("--json", type=Path, help="write the figures there as well")
    given, options = parser.parse_known_args(arguments)
    on = machine()
    try:
        with tempfile.TemporaryDirectory(prefix="reskpn-recovery-") as folder:
            found = list(measure(given.rounds, run_options(options), Path(folder)))
    except ReskpnError as error:
        print(f"recovery: {error}", file=sys.stderr)
        return error.exit_code
    print("\n".join([*describe(on), *table(found)]))
    if given.json:
        given.json.write_text(json.dumps({"machine": on, "rounds": [asdict(one) for one in found]}, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
