"""How long a run takes to start, the first time and the second: what is compiled, and what comes from JAX's cache.

    python -m benchmarks.start
    python -m benchmarks.start --task humanoid --learner reskpn --num-envs 2048 --starts 3

All starts share a compilation cache of their own, empty before the first. Each consists of a learner and an actor by
themselves, phase by phase (`benchmarks.start_phases`), and of `reskpn train` with one update: seconds from the command
to the update in the log. Other options are settings of the run. The machine should otherwise be idle.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.machine import describe, machine
from benchmarks.processes import run_json, run_module
from benchmarks.start_phases import ROLES
from common.errors import ReskpnError
from common.log.reader import LogReader
from common.runtime import CACHE_VARIABLE

GOAL_S = 5.0
"""Promised seconds in which each process of a second start has its programs, on an idle CPU."""

COMPILING = {"learner": ("initial state", "update"), "actor": ("environments", "rollout")}
"""Phases between a process's imports and its first update or rollout."""

NS = 1e-9


@dataclass(frozen=True)
class Start:
    """One start: the reports of both roles, and seconds from `reskpn train` to the first update."""

    roles: dict[str, dict[str, Any]]
    first_update_s: float

    def compiling_s(self, role: str, clock: int = 0) -> float:
        """Seconds (clock 0) or CPU seconds (1) in which the process gets its programs."""
        return sum(float(self.roles[role]["seconds"][name][clock]) for name in COMPILING[role])


def start(settings: list[str]) -> Start:
    """Start each role by itself, and a run. Raises ProcessError where one fails."""
    roles = {role: run_json("benchmarks.start_phases", ["--role", role, *settings]) for role in ROLES}
    with tempfile.TemporaryDirectory(prefix="reskpn-start-") as folder:
        run_dir = Path(folder) / "run"
        began_ns = time.time_ns()
        run_module("reskpn", ["train", *settings, "--run-dir", str(run_dir), "--evaluation.episodes", "0"])
        first = next(LogReader(run_dir).messages(["/update"]))
    return Start(roles, (first.t_ns - began_ns) * NS)


def tables(starts: Sequence[Start]) -> Iterator[str]:
    """Markdown: seconds by phase and start, with CPU seconds in brackets, and whether the goal is met."""
    names = " | ".join(f"start {number}" for number in range(1, len(starts) + 1))
    yield f"| seconds (of CPU time) | {names} |"
    yield "|---" * (len(starts) + 1) + "|"

    def row(name: str, cells: Sequence[str]) -> str:
        return f"| {name} | {' | '.join(cells)} |"

    for role in ROLES:
        reports = [each.roles[role] for each in starts]
        for phase in reports[0]["seconds"]:
            yield row(f"{role}: {phase}", [_seconds(*report["seconds"][phase]) for report in reports])
        yield row(
            f"{role}: programs, of them from the cache", [f"{each['programs']}, {each['cached']}" for each in reports]
        )
        yield row(
            f"**{role}: until its programs are there**",
            [_seconds(each.compiling_s(role), each.compiling_s(role, 1)) for each in starts],
        )
    yield row("**`reskpn train` to the first update**", [f"{each.first_update_s:.1f}" for each in starts])
    yield ""
    for role in ROLES:
        slowest = max(each.compiling_s(role) for each in starts[1:])
        met = "met" if slowest <= GOAL_S else "missed"
        yield f"goal for the {role} from the second start on: at most {GOAL_S:g} s, {met} ({slowest:.1f} s)"
        alike = len({each.roles[role]["digest"] for each in starts}) == 1
        yield f"{role}: {'the same bits at every start' if alike else 'OTHER BITS than at the first start'}"


def _seconds(wall: float, cpu: float) -> str:
    return f"{wall:.1f} ({cpu:.1f})"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = _parser()
    given, further = parser.parse_known_args(arguments)
    if given.starts < 2:
        parser.error(f"--starts is {given.starts}; it must be at least 2, for the first fills the cache")
    found = machine()
    sizes = {"--task": given.task, "--learner": given.learner, "--num-envs": given.num_envs, "--actors": 1}
    sizes |= {"--num-steps": given.num_steps, "--total-steps": given.num_envs * given.num_steps}
    settings = ["--config", "paper"] + [word for name, value in sizes.items() for word in (name, str(value))] + further
    try:
        with tempfile.TemporaryDirectory(prefix="reskpn-cache-") as cache:
            os.environ[CACHE_VARIABLE] = cache
            starts = [start(settings) for _ in range(given.starts)]
    except ReskpnError as error:
        print(f"start: {error}", file=sys.stderr)
        return error.exit_code
    print(f"{given.task}, {given.learner}: {given.num_envs} environments x {given.num_steps} steps, one actor")
    for line in (*describe(found), "", *tables(starts)):
        print(line)
    if given.json:
        content = [{"roles": each.roles, "first_update_s": each.first_update_s} for each in starts]
        given.json.write_text(json.dumps({"machine": found, "options": settings, "starts": content}, indent=2) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.start",
        description="Seconds until a run works, at the first start and at later ones. Further options are settings of "
        "the run, such as --algorithm.hidden 64,64.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--task", default="hopper", help="environment")
    parser.add_argument("--learner", default="reskpn", help="algorithm")
    parser.add_argument("--num-envs", type=int, default=2048, metavar="N", help="environments")
    parser.add_argument("--num-steps", type=int, default=10, metavar="N", help="steps of each for one update")
    parser.add_argument("--starts", type=int, default=2, metavar="N", help="starts with one cache")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure there, too")
    return parser


if __name__ == "__main__":
    sys.exit(main())
