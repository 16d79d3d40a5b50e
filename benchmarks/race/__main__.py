"""The command line of the race: makes the runs that are missing, in turns."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.race.entrants import ENVIRONMENTS, Entrant, Run, entrant, known_task
from benchmarks.race.records import RESULTS, RaceResult, find, path_of
from benchmarks.race.running import race
from common.errors import ReskpnError, SettingsError
from reskpn.study.writing import write_result

SMOKE_MINUTES = 0.5

Due = tuple[str, int, Entrant]


def missing(given: argparse.Namespace, entrants: Sequence[Entrant]) -> list[Due]:
    """The runs that have no result yet: all entrants of a task and seed follow each other."""
    every = [(task, seed, each) for task in given.tasks for seed in given.seeds for each in entrants]
    return [due for due in every if find(given.results, due[2], due[0], due[1], given.minutes) is None]


def make(given: argparse.Namespace, due: Sequence[Due]) -> Iterator[RaceResult]:
    """Make the runs one after the other and write each when it is finished. Raises as `race` and `write_result`."""
    for task, seed, each in due:
        result = race(each, task, seed, given.minutes, given.cores)
        write_result(result, path_of(given.results, each, task, seed))
        yield result


def line(result: RaceResult, left: int, minutes: float) -> str:
    """One line on a finished run."""
    found = result.curve.return_at(result.minutes * 60)
    shown = "no episode ended" if found is None else f"return {found:,.0f}"
    rest = f"; {left} left, about {left * minutes:,.0f} min" if left else ""
    return (
        f"{result.task}, seed {result.seed}, {result.entrant}: {shown} after {result.minutes:g} min, "
        f"{result.curve.env_steps[-1]:,} steps{rest}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    if given.smoke:
        given.minutes, given.results = SMOKE_MINUTES, Path("build/race-smoke")
    try:
        if not given.minutes > 0:
            raise SettingsError(f"--minutes is {given.minutes:g}; it must be more than 0")
        given.tasks = [known_task(name) for name in given.tasks]
        entrants = [entrant(name) for name in given.entrants]
        for each in entrants:  # what is not installed, or not possible, is said before the first run
            for task in given.tasks:
                each.command(Run(task, 0, Path()))
                each.identity(task)
        due = missing(given, entrants)
        print(f"{len(due)} runs of {given.minutes:g} minutes to make", file=sys.stderr, flush=True)
        for number, result in enumerate(make(given, due), start=1):
            print(line(result, len(due) - number, given.minutes), flush=True)
    except ReskpnError as error:
        print(f"race: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("race: stopped; give the command again and it goes on", file=sys.stderr)
        return 130
    print(f"draw the results: python -m benchmarks.race.draw --results {given.results}", file=sys.stderr)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.race",
        description="Training return by wall time, this project beside its peers, in turns on the same cores.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--tasks", nargs="+", default=["hopper"], metavar="TASK", help=f"Gymnasium's tasks: {', '.join(ENVIRONMENTS)}"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N", help="seeds")
    parser.add_argument("--minutes", type=float, default=3.0, help="wall time of a run, from the launch of its process")
    parser.add_argument(
        "--entrants",
        nargs="+",
        default=["default", "sb3", "sbx", "reference"],
        metavar="NAME",
        help="presets or .yaml files of this project's settings, sb3, sbx, reference, rsl_rl, brax",
    )
    parser.add_argument("--cores", type=int, default=2, metavar="N", help="cores that every entrant has")
    parser.add_argument("--results", type=Path, default=RESULTS, metavar="DIR", help="where results are kept")
    parser.add_argument(
        "--smoke", action="store_true", help=f"{SMOKE_MINUTES * 60:g} s a run, kept in build/race-smoke: does it work?"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
