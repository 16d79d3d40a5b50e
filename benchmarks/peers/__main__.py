"""Peers side by side on one machine: the speed of physics in turns, and the training runs of the race.

    make bench-peers
    python -m benchmarks.peers --task hopper --rounds 3 --minutes 10 --seeds 0 1 2 3 4

Training runs are those of `benchmarks.race`, kept and found again as there.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import describe, machine
from benchmarks.peers import environment
from benchmarks.processes import last_json, run_to_end
from benchmarks.race import __main__ as race
from benchmarks.race.entrants import ENVIRONMENTS, known_task
from benchmarks.race.records import RESULTS, read_all
from benchmarks.race.standings import current, standings
from common.errors import ProcessError, ReskpnError

ENTRANTS = ("default", "brax", "sb3", "sbx", "rsl_rl", "reference")

ENGINES = {
    "native": "this project's engine in the product: observations, rewards, ends and starts of episodes included",
    "rollout": "mujoco.rollout: physics alone, open loop, nothing observed, ended or reset",
    "envpool": "EnvPool: observations, rewards, ends and starts included; stepped from Python",
}

Samples = Mapping[str, Sequence[Mapping[str, Any]]]


def measure(engine: str, task: str, sizes: Sequence[str]) -> dict[str, Any]:
    """One engine in a new process. ProcessError where it fails, or its environment is missing."""
    python = environment.python() if engine == "envpool" else sys.executable
    words = [engine, "--task", ENVIRONMENTS[task].lower(), "--environment", ENVIRONMENTS[task], *sizes]
    done = run_to_end("benchmarks.peers.engines", words, python)
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:] or ["it said nothing"]
        raise ProcessError(f"{engine} ended with exit code {done.returncode}: {last[0]}")
    return last_json(done.stdout)


def physics_table(samples: Samples) -> Iterator[str]:
    """One row an engine: median of the rounds, and the ratio to `native`, round by round."""
    yield "| engine | env steps/s | of native, median of rounds | versions | what it does |"
    yield "|---|---|---|---|---|"
    for engine, found in samples.items():
        speed = statistics.median(each["steps_per_s"] for each in found)
        pairs = zip(found, samples["native"], strict=True)
        ratio = statistics.median(one["steps_per_s"] / other["steps_per_s"] for one, other in pairs)
        versions = ", ".join(f"{name} {version}" for name, version in found[0]["versions"].items())
        yield f"| {engine} | {speed:,.0f} | {ratio:.2f} | {versions} | {ENGINES[engine]} |"


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    if given.smoke:
        given.rounds, given.minutes, given.seeds, given.num_envs, given.steps = 1, race.SMOKE_MINUTES, [0], 16, 10
        given.results = Path("build/peers/smoke")
    sizes = ["--num-envs", str(given.num_envs), "--steps", str(given.steps)]
    try:
        known_task(given.task)
        environment.python()
        for line in describe(machine()):
            print(line)
        samples: dict[str, list[dict[str, Any]]] = {engine: [] for engine in ENGINES}
        for _ in range(given.rounds):
            for engine, found in samples.items():
                found.append(measure(engine, given.task, sizes))
        print(f"\n{given.task}, {given.num_envs} environments, {given.steps} steps a rollout\n")
        for line in physics_table(samples):
            print(line, flush=True)
        words = ["--tasks", given.task, "--seeds", *map(str, given.seeds), "--minutes", str(given.minutes)]
        if (code := race.main([*words, "--entrants", *given.entrants, "--results", str(given.results)])) != 0:
            return code
        results, left_out = current([each for each in read_all(given.results) if each.task == given.task])
        print("\n" + standings(results, left_out).markdown(), end="")
    except ReskpnError as error:
        print(f"peers: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers",
        description="Speed of physics and of training, and time to a return of 1,000, beside other libraries.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--task", default="hopper", help=f"one of {', '.join(ENVIRONMENTS)}")
    parser.add_argument("--num-envs", type=int, default=2048, metavar="N", help="environments of the physics part")
    parser.add_argument("--steps", type=int, default=100, metavar="T", help="steps of a rollout of the physics part")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="rounds of the physics part, in turns")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4], metavar="N", help="training runs")
    parser.add_argument("--minutes", type=float, default=10.0, help="wall time of a training run")
    parser.add_argument("--entrants", nargs="+", default=list(ENTRANTS), metavar="NAME", help="who trains")
    parser.add_argument("--results", type=Path, default=RESULTS, metavar="DIR", help="where training runs are kept")
    parser.add_argument("--smoke", action="store_true", help="small and short, kept in build/peers/smoke")
    return parser


if __name__ == "__main__":
    sys.exit(main())
