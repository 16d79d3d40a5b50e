"""What became slower than the committed results: ratios within one run against ratios within theirs.

    python -m benchmarks.regressions            # or: make bench-compare
    python -m benchmarks.regressions --record   # replace the committed results, on a quiet machine

Seconds of two machines or hours say nothing, ratios do: PPO's update by the time that its matrix products must take at
the speed that the processor reaches in the same process, and every other update by PPO's. What has more than 1.1 times
its committed ratio is named, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import describe, machine
from benchmarks.profile import network_flop, product_speed
from benchmarks.update import CASES, measure
from common.config.settings import RunSettings
from common.runtime import enable_compilation_cache

RESULTS = Path(__file__).parent / "results" / "update.json"

MEASURED = ("ppo", "exact n=1 M=2441", "rff n=B M=256")
"""Cases of `benchmarks.update`: the networks alone, the paper's h, and the cheapest whole-batch one."""

LIMIT = 1.1
"""Largest quotient of a ratio and its committed value that is not named."""

BY_PRODUCTS = "ppo by its matrix products"

Ratios = dict[str, dict[str, float]]
"""By task and name."""


def measured_ratios(tasks: Sequence[str], rounds: int) -> Ratios:
    """The ratios of this source tree."""
    cases = [case for case in CASES if case.name in MEASURED]
    found: Ratios = {}
    for task in tasks:
        settings = RunSettings.model_validate({"task": task, "learner": "ppo", "actors": 1})
        rows, width = settings.batch_size // settings.algorithm.minibatches, settings.algorithm.hidden[-1]
        before = product_speed(rows, width)
        table = measure(task, cases, rounds)
        peak = statistics.mean([before, product_speed(rows, width)])
        found[task] = {BY_PRODUCTS: table[0]["seconds"] * peak / network_flop(settings)}
        found[task] |= {f"{row['case']} by ppo": row["ratio"] for row in table[1:]}
    return found


def compared(old: Ratios, new: Ratios) -> Iterator[tuple[str, float, float]]:
    """(name, committed ratio, ratio now) of what both have."""
    for task, ratios in new.items():
        for name, ratio in ratios.items():
            if name in old.get(task, {}):
                yield f"{task}, {name}", old[task][name], ratio


def slower(old: Ratios, new: Ratios) -> list[str]:
    """A sentence for everything that became slower than `LIMIT` times."""
    return [
        f"{name}: {after:.2f}, {after / before:.2f} times the committed {before:.2f}"
        for name, before, after in compared(old, new)
        if after > LIMIT * before
    ]


def report(committed: Mapping[str, Any], new: Ratios) -> Iterator[str]:
    """The lines of a comparison."""
    of = committed["machine"]
    yield f"committed: commit {of['commit'][:12]}, {of['date']}, {of['cores']} cores of {of['cpu']}"
    yield f"{'':44} {'committed':>9} {'now':>9} {'quotient':>9}"
    for name, before, after in compared(committed["ratios"], new):
        yield f"{name:44} {before:9.2f} {after:9.2f} {after / before:9.2f}"
    found = slower(committed["ratios"], new)
    yield from (f"slower: {line}" for line in found)
    if not found:
        yield f"nothing is slower than {LIMIT} times the committed results"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.regressions", description=__doc__.split("\n")[0])
    parser.add_argument("--task", action="append", help="default: hopper")
    parser.add_argument("--rounds", type=int, default=7, help="updates of each case (default 7)")
    parser.add_argument("--record", action="store_true", help=f"write {RESULTS.name} anew instead of comparing")
    given = parser.parse_args(arguments)
    if not given.record and not RESULTS.exists():
        parser.error(f"there are no committed results in {RESULTS}; --record makes them, on a quiet machine")
    enable_compilation_cache()
    found = machine()
    print(*describe(found), sep="\n")
    ratios = measured_ratios(given.task or ["hopper"], given.rounds)
    if given.record:
        RESULTS.parent.mkdir(exist_ok=True)
        RESULTS.write_text(json.dumps({"machine": found, "rounds": given.rounds, "ratios": ratios}, indent=1) + "\n")
        print(f"wrote {RESULTS}")
        return 0
    committed = json.loads(RESULTS.read_text())
    print(*report(committed, ratios), sep="\n")
    return 1 if slower(committed["ratios"], ratios) else 0


if __name__ == "__main__":
    sys.exit(main())
