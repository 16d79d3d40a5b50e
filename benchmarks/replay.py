"""The cost of a replay: verification relative to the run's own speed, and the speed of reading rollouts.

    python -m benchmarks.replay --run runs/x
    python -m benchmarks.replay --task hopper --learner dpo --total-steps 6e5

With a run directory, that run is replayed; otherwise a run is trained first, with the options as settings.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.machine import describe, machine
from benchmarks.processes import run_module
from common.errors import ReskpnError
from common.log.reader import LogReader
from common.runs.read_ahead import read_ahead
from common.runs.recorded_run import open_run
from common.runtime import enable_compilation_cache
from services.learner.training.trainer import Trainer
from services.replay.verify import Verdict, verify

GOAL_SPEED = 1.2
"""Promised speed of verification relative to the run's own."""

GOAL_READING = 1.0
"""Promised GB/s of reading rollout messages."""

READ_BYTES = 2e9
"""Minimum amount to read for one measurement, reading the same log repeatedly if necessary."""


@dataclass(frozen=True)
class Reading:
    """Speed of reading rollout messages from a log in the page cache: GB/s as bytes, and decoded and checked."""

    megabytes: float
    bytes_gb_s: float
    decoded_gb_s: float


def measure_verify(run_dir: Path, until: int | None) -> Verdict:
    """Verify a run with a precompiled update; the run's speed excludes its first update."""
    run = open_run(run_dir)
    trainer = Trainer(run.settings)
    if (initial := run.initial_state()) is not None:
        trainer.restore(initial)
    trainer.compile()
    with read_ahead(run.updates(until=until)) as updates:
        return verify(updates, trainer, allow_other_bits=False, on_update=lambda _: None)


def measure_reading(run_dir: Path, rounds: int) -> Reading:
    """The median over the rounds, of passes through the whole log."""

    def raw() -> int:
        return sum(len(message.data) for message in LogReader(run_dir).messages(["/rollout"]))

    def decoded() -> int:
        return sum(rollout.nbytes for update in open_run(run_dir).updates() for rollout in update.rollouts)

    size = raw()
    passes = max(1, round(READ_BYTES / size))
    return Reading(size / 1e6, _gb_s(raw, passes, rounds), _gb_s(decoded, passes, rounds))


def _gb_s(read: Callable[[], int], passes: int, rounds: int) -> float:
    speeds = []
    for _ in range(rounds):
        began_s = time.perf_counter()
        size = sum(read() for _ in range(passes))
        speeds.append(size / 1e9 / (time.perf_counter() - began_s))
    return statistics.median(speeds)


def table(verdict: Verdict, reading: Reading) -> Iterator[str]:
    """Readable lines with the results."""
    assert verdict.speed is not None
    yield f"{'':34}{'measured':>12}{'goal':>8}"
    yield f"{'updates equal bit for bit':34}{verdict.updates:>12}"
    yield f"{'verify, by the speed of the run':34}{verdict.speed:>12.2f}{GOAL_SPEED:>8.1f}"
    yield f"{'  seconds of the run':34}{verdict.live_s:>12.1f}"
    yield f"{'  seconds of verification':34}{verdict.replay_s:>12.1f}"
    yield f"{'rollout messages read, GB/s':34}{reading.bytes_gb_s:>12.2f}{GOAL_READING:>8.1f}"
    yield f"{'  decoded and checked, GB/s':34}{reading.decoded_gb_s:>12.2f}"


def main(arguments: Sequence[str] | None = None) -> int:
    given, settings = _parser().parse_known_args(arguments)
    enable_compilation_cache()
    found = machine()
    try:
        with tempfile.TemporaryDirectory(prefix="reskpn-replay-") as folder:
            run_dir = given.run
            if run_dir is None:
                run_dir = Path(folder) / "run"
                run_module(
                    "reskpn",
                    ["train", "--config", "paper", "--run-dir", str(run_dir), "--evaluation.episodes", "0", *settings],
                )
            reading = measure_reading(run_dir, given.rounds)
            verdict = measure_verify(run_dir, given.until)
    except ReskpnError as error:
        print(f"replay: {error}", file=sys.stderr)
        return error.exit_code
    if verdict.divergence is not None or verdict.speed is None:
        print("replay: the run does not verify, or has one update only: its speed would mean nothing", file=sys.stderr)
        return 1
    for line in (*describe(found), f"log of {reading.megabytes:,.0f} MB", "", *table(verdict, reading)):
        print(line)
    if given.json:
        content = {"machine": found, "options": settings, "verify": asdict(verdict), "reading": asdict(reading)}
        given.json.write_text(json.dumps(content, indent=2) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.replay",
        description="Speed of verification against that of the run, and of reading its log. Further options are "
        "settings of the run that is trained for it, such as --task hopper.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--run", type=Path, metavar="DIR", help="run directory; without it a run is trained")
    parser.add_argument("--until", type=int, metavar="V", help="verify up to this version")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="rounds of reading")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    return parser


if __name__ == "__main__":
    sys.exit(main())
