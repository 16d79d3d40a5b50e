"""The cost of the log: CPU time of writing rollouts at a run's rate, and the speed of reading them.

    python -m benchmarks.log --rate 22 --seconds 20

Messages of the size of a real rollout are passed to the writer at an even rate, as a learner does; the CPU time of the
same process without a log is subtracted, pair by pair. The log is written to `--folder`, by default the system's
directory for temporary files.
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

import numpy as np

from benchmarks.machine import describe, machine
from common.errors import ReskpnError
from common.log.chain import Chain
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.memory import keep_large_blocks

GOAL_SHARE = 0.03
"""Upper bound on the share of one core at 22 MB/s."""

GOAL_READING = 1.0
"""GB/s."""

MB = 1_000_000
CHAINED_MB = 200.0
"""Of messages, in each round of the chain's measurement."""


@dataclass(frozen=True)
class Load:
    """The load: MB per second, MB per message, and duration in seconds."""

    rate: float
    message: float
    seconds: float


@dataclass(frozen=True)
class Figures:
    """Medians over the rounds, and every round: cores used, busy share of the log's thread, and GB/s of reading.

    `chain_us_per_mb`: processor time of the chain over messages of that size, which the log above was written without.
    """

    share: float
    shares: list[float]
    at_work: float
    reading_gb_s: float
    chain_us_per_mb: float


def paced(load: Load, write: Callable[[bytes], None]) -> tuple[float, float]:
    """Write messages at the load's rate; returns wall and CPU seconds, including the last flush."""
    data = np.random.default_rng(0).bytes(round(load.message * MB))
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    for number in range(max(1, round(load.seconds * load.rate / load.message))):
        time.sleep(max(0.0, began_s + number * load.message / load.rate - time.perf_counter()))
        write(data)
    write(b"")
    return time.perf_counter() - began_s, time.process_time() - began_cpu_s


def one_round(load: Load, folder: Path) -> tuple[float, float, float]:
    """(share of a core used by the log, busy share of its thread, GB/s of reading)."""
    wall_s, idle_cpu_s = paced(load, lambda _: None)
    with tempfile.TemporaryDirectory(prefix="reskpn-log-", dir=folder) as place, LogWriter(Path(place)) as log:

        def write(data: bytes) -> None:
            if data:
                log.write("/rollout", data)
            else:
                log.flush(timeout_s=60.0)

        logged_s, cpu_s = paced(load, write)
        at_work = log.busy_s / logged_s
        log.close()
        began_s = time.perf_counter()
        size = sum(len(message.data) for message in LogReader(Path(place)).messages(["/rollout"]))
        reading = size / 1e9 / (time.perf_counter() - began_s)
    return cpu_s / logged_s - idle_cpu_s / wall_s, at_work, reading


def chain_cost(load: Load) -> float:
    """Processor time in microseconds by which the chain follows a megabyte of messages."""
    data, chain = np.random.default_rng(0).bytes(round(load.message * MB)), Chain()
    count = max(1, round(CHAINED_MB / load.message))
    began_cpu_s = time.process_time()
    for number in range(count):
        chain.add("/rollout", number, data)
    return (time.process_time() - began_cpu_s) * 1e6 / (count * load.message)


def measure(load: Load, rounds: int, folder: Path) -> Figures:
    """Measure over `rounds` rounds."""
    found = [one_round(load, folder) for _ in range(rounds)]
    shares, at_work, reading = (list(values) for values in zip(*found, strict=True))
    chained = statistics.median(chain_cost(load) for _ in range(rounds))
    return Figures(statistics.median(shares), shares, statistics.median(at_work), statistics.median(reading), chained)


def table(figures: Figures, load: Load) -> Iterator[str]:
    """Readable lines with the results."""
    yield f"{'':34}{'measured':>12}{'goal':>8}"
    yield f"{'cores used by the log':34}{figures.share:>12.4f}{GOAL_SHARE:>8.2f}"
    yield f"{'  round by round':34}  {' '.join(f'{share:.4f}' for share in figures.shares)}"
    yield f"{'busy share of its thread':36}{figures.at_work:>10.4f}"
    yield f"{'the chain, us per MB':34}{figures.chain_us_per_mb:>12.0f}"
    yield f"{'  in cores at that rate':34}{figures.chain_us_per_mb * load.rate / 1e6:>12.4f}"
    yield f"{'rollout messages read, GB/s':34}{figures.reading_gb_s:>12.2f}{GOAL_READING:>8.1f}"


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    keep_large_blocks()  # as a learner does
    found = machine()
    load = Load(given.rate, given.message, given.seconds)
    try:
        figures = measure(load, given.rounds, given.folder)
    except ReskpnError as error:
        print(f"log: {error}", file=sys.stderr)
        return error.exit_code
    about = f"{load.rate:g} MB/s in messages of {load.message:g} MB, for {load.seconds:g} s"
    for line in (*describe(found), about, "", *table(figures, load)):
        print(line)
    if given.json:
        content = {"machine": found, "load": asdict(load), "figures": asdict(figures)}
        given.json.write_text(json.dumps(content, indent=2) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.log",
        description="Processor time of logging at a run's pace, and speed of reading the log.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--rate", type=float, default=22.0, metavar="MB", help="MB a second")
    parser.add_argument("--message", type=float, default=1.4, metavar="MB", help="MB of one rollout")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="of writing, each round")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="rounds, with and without a log")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help="a folder on the disk meant")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    return parser


if __name__ == "__main__":
    sys.exit(main())
