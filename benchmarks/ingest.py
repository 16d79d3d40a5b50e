"""The learner's cost of receiving rollouts, by number of actors, and the number of actors one learner can serve.

    python -m benchmarks.ingest --json ingest.json

The learner's hub, fleet, log and all messages are real, but there are no updates, and the actors push a synthetic
rollout. In each turn a bare socket receives messages of the same size from as many processes, for comparison.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.ingest_learner import Ingest
from benchmarks.machine import describe, machine
from benchmarks.processes import bare_environment, run_json
from benchmarks.raw_socket import receive
from common.config.settings import RunSettings
from common.errors import ReskpnError, SettingsError
from common.wire.endpoint import free_port

END_S = 20.0

ACTOR_STEPS_PER_S = {"hopper": 27_800.0, "humanoid": 12_100.0}
"""Environment steps per second of a real actor with one core: the steps per CPU second in docs/physics.md."""


@dataclass(frozen=True)
class Point:
    """Results for one number of actors: the learner's side, and bytes per second of the bare socket."""

    ingest: Ingest
    socket_bytes_per_s: float

    @property
    def rollouts_per_s(self) -> float:
        return self.ingest.rollouts / self.ingest.seconds

    @property
    def bytes_per_s(self) -> float:
        return self.rollouts_per_s * self.ingest.rollout_bytes

    @property
    def cpu_per_rollout_s(self) -> float:
        """The learner's CPU seconds per rollout, including its share of snapshots and orders."""
        return self.ingest.cpu_s / self.ingest.rollouts


def measure(task: str, actors: int, envs: int, steps: int, seconds: float) -> Point:
    """Measure one learner with `actors` actors of `envs` environments each. Raises ProcessError if a process fails."""
    settings = RunSettings.model_validate(
        {
            "task": task,
            "actors": actors,
            "num_envs": actors * envs,
            "num_steps": steps,
            "total_steps": actors * envs * steps,
            "physics": "native",
            "transport": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
        }
    )
    with tempfile.TemporaryDirectory(prefix="reskpn-ingest-") as folder, _actors(settings):
        arguments = [settings.model_dump_json(), folder, str(seconds)]
        found = Ingest(**run_json("benchmarks.ingest_learner", arguments))
    return Point(found, receive(found.rollout_bytes, actors, seconds))


@contextmanager
def _actors(settings: RunSettings) -> Iterator[None]:
    """The actors' processes. They exit at the end of the run, and at the latest with this context."""
    command = [sys.executable, "-m", "benchmarks.ingest_actor", settings.transport.endpoint]
    processes = [subprocess.Popen(command, env=bare_environment()) for _ in range(settings.actors)]
    try:
        yield
        for process in processes:
            process.wait(END_S)
    finally:
        for process in processes:
            process.kill()
            process.wait()


def table(points: Sequence[Point]) -> Iterator[str]:
    columns = ("actors", "rollouts/s", "MB/s", "socket MB/s", "ratio", "CPU ms/rollout", "idle CPU %", "per actor %")
    yield "".join(f"{column:>16}" for column in columns)
    for point in points:
        actors, idle = point.ingest.actors, 100 * point.ingest.idle_cpu
        ratio = point.bytes_per_s / point.socket_bytes_per_s
        cells = (
            f"{actors}",
            f"{point.rollouts_per_s:,.1f}",
            f"{point.bytes_per_s / 1e6:,.0f}",
            f"{point.socket_bytes_per_s / 1e6:,.0f}",
            f"{ratio:.2f}",
            f"{1e3 * point.cpu_per_rollout_s:,.1f}",
            f"{idle:.2f}",
            f"{idle / actors:.3f}",
        )
        yield "".join(f"{cell:>16}" for cell in cells)


@dataclass(frozen=True)
class Limit:
    """The most that was taken in, and the actors that bring so much.

    Attributes:
        steps_per_s: environment steps.
        fleet: actors that make so many at `actor_steps_per_s` each, if the learner did nothing else.
        core_fleet: actors whose rollouts and heartbeats keep one core of the learner busy.
    """

    bytes_per_s: float
    rollouts_per_s: float
    steps_per_s: float
    actor_steps_per_s: float
    fleet: int
    core_fleet: int


def limit(points: Sequence[Point], actor_steps_per_s: float) -> Limit:
    """Estimate from the point with the highest throughput; the cost per actor is from that with the most actors."""
    best = max(points, key=lambda point: point.bytes_per_s)
    largest = max(points, key=lambda point: point.ingest.actors)
    steps = best.ingest.steps_per_rollout
    rollouts_of_one = actor_steps_per_s / steps
    cpu_of_one = rollouts_of_one * largest.cpu_per_rollout_s + largest.ingest.idle_cpu / largest.ingest.actors
    return Limit(
        bytes_per_s=best.bytes_per_s,
        rollouts_per_s=best.rollouts_per_s,
        steps_per_s=best.rollouts_per_s * steps,
        actor_steps_per_s=actor_steps_per_s,
        fleet=math.floor(best.rollouts_per_s / rollouts_of_one),
        core_fleet=math.floor(1.0 / cpu_of_one),
    )


def describe_limit(found: Limit) -> str:
    return (
        f"at most {found.bytes_per_s / 1e6:,.0f} MB/s = {found.rollouts_per_s:,.1f} rollouts/s = "
        f"{found.steps_per_s:,.0f} steps/s: {found.fleet:,} actors of {found.actor_steps_per_s:,.0f} steps/s; "
        f"{found.core_fleet:,} of them keep one core of the learner busy"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    found, record = machine(), {}
    for line in describe(found):
        print(line)
    try:
        for task in given.tasks:
            if task not in ACTOR_STEPS_PER_S:
                raise SettingsError(f"--tasks {task}: allowed: {', '.join(ACTOR_STEPS_PER_S)}")
            points = []
            for actors in given.actors:
                points.append(measure(task, actors, given.envs, given.steps, given.seconds))
                print(f"{task}: {actors} actors done", file=sys.stderr, flush=True)
            most = limit(points, ACTOR_STEPS_PER_S[task])
            size = points[0].ingest
            print(
                f"\n{task}: {given.envs} environments x {given.steps} steps an actor; rollout {size.rollout_bytes:,} "
                f"bytes, policy {size.snapshot_bytes:,} bytes"
            )
            for line in (*table(points), describe_limit(most)):
                print(line)
            record[task] = {"points": [asdict(point) for point in points], "limit": asdict(most)}
    except ReskpnError as error:
        print(f"ingest: {error}", file=sys.stderr)
        return error.exit_code
    if given.json:
        given.json.write_text(
            json.dumps({"machine": found, "seconds": given.seconds, "tasks": record}, indent=2) + "\n"
        )
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ingest",
        description="Cost of rollouts and actors to a learner, its limit, and a bare socket's. The logs, some GB, "
        "go to TMPDIR and are removed.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--tasks", nargs="+", default=list(ACTOR_STEPS_PER_S), help="whose message sizes")
    add("--actors", type=int, nargs="+", default=[1, 2, 4, 8, 16], metavar="N", help="numbers of actors to measure")
    add("--envs", type=int, default=512, metavar="N", help="environments of each actor")
    add("--steps", type=int, default=10, metavar="N", help="steps of a rollout")
    add("--seconds", type=float, default=5.0, metavar="S", help="of each measurement")
    add("--json", type=Path, metavar="FILE", help="write every figure there, too")
    return parser


if __name__ == "__main__":
    sys.exit(main())
