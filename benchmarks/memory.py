"""The growth of memory: resident memory of the learner and its actors, sampled over a real run.

    python -m benchmarks.memory --minutes 30
    python -m benchmarks.memory --minutes 5 --task hopper --learner ppo

The first fifth of the samples, with compilation and first buffers, is left out. Further options are settings of the
run, which is stopped at the end. Growth is the slope of a line fitted to the other samples.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.machine import describe, machine
from benchmarks.processes import bare_environment
from common.errors import ProcessError, ReskpnError
from common.log.reader import LogReader

SERVICES = ("learner", "actor")
SAMPLE_S = 5.0
LEFT_OUT = 0.2
MB = 1e6
ENDLESS = "1e12"
STOP_S = 60.0


@dataclass(frozen=True)
class Growth:
    """Resident memory of one process in MB, after the first samples, and its slope in MB/hour.

    `first` and `last` are medians of the first and last tenth; `series` is every sample, those left out among them.
    """

    first: float
    last: float
    least: float
    most: float
    an_hour: float
    samples: int
    series: list[float]


def growth(times_s: Sequence[float], resident_mb: Sequence[float]) -> Growth:
    """The growth over the samples after the warm-up.

    Raises:
        ProcessError: there are too few.
    """
    begin = int(len(times_s) * LEFT_OUT)
    times, values = np.array(times_s[begin:]), np.array(resident_mb[begin:])
    if len(values) < 3:
        raise ProcessError("the run ended before enough samples were taken; give more --minutes")
    slope = np.polyfit(times - times[0], values, 1)[0] * 3600
    tenth = math.ceil(len(values) / 10)
    first, last = float(np.median(values[:tenth])), float(np.median(values[-tenth:]))
    least, most = float(values.min()), float(values.max())
    return Growth(first, last, least, most, float(slope), len(values), list(resident_mb))


def services(parent: int) -> dict[str, int]:
    """The process ids of the run's live services by name: "learner", "actor 0", ..."""
    found: dict[str, int] = {}
    for pid in map(int, Path(f"/proc/{parent}/task/{parent}/children").read_text().split()):
        words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        for name in SERVICES:
            if name in words:
                found[name if name == "learner" else f"{name} {sum(name in other for other in found)}"] = pid
    return found


def resident_mb(pid: int) -> float:
    """Resident memory of the process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MB


def watch(process: subprocess.Popen[bytes], minutes: float) -> dict[str, tuple[list[float], list[float]]]:
    """Sample memory for `minutes` minutes: seconds and MB by service.

    Raises:
        ProcessError: the run ends by itself.
    """
    samples: dict[str, tuple[list[float], list[float]]] = {}
    began_s = time.monotonic()
    while (now_s := time.monotonic() - began_s) < 60 * minutes:
        if process.poll() is not None:
            raise ProcessError(f"the run ended after {now_s:.0f} s with exit code {process.returncode}")
        for name, pid in services(process.pid).items():
            times, values = samples.setdefault(name, ([], []))
            times.append(now_s)
            values.append(resident_mb(pid))
        time.sleep(SAMPLE_S)
    return samples


def measure(minutes: float, settings: Sequence[str]) -> tuple[dict[str, Growth], int]:
    """Measure the growth by service over a run of `minutes` minutes, and its number of updates."""
    with tempfile.TemporaryDirectory(prefix="reskpn-memory-") as folder:
        run_dir = Path(folder) / "run"
        command = [sys.executable, "-m", "reskpn", "train", "--config", "paper", "--run-dir", str(run_dir), *settings]
        process = subprocess.Popen(command, env=bare_environment(), stdout=subprocess.DEVNULL)
        try:
            samples = watch(process, minutes)
            process.send_signal(signal.SIGINT)
            process.wait(STOP_S)
        finally:
            process.kill()
            process.wait()
        updates = LogReader(run_dir).counts().get("/update", 0)
    return {name: growth(*taken) for name, taken in samples.items()}, updates


def table(found: dict[str, Growth]) -> Iterator[str]:
    """Readable lines with the results."""
    yield f"{'resident MB':12}{'first':>9}{'last':>9}{'least':>9}{'most':>9}{'MB/hour':>13}"
    for name, grown in found.items():
        cells = "".join(f"{value:>9,.0f}" for value in (grown.first, grown.last, grown.least, grown.most))
        yield f"{name:12}{cells}{grown.an_hour:>13,.1f}"


def main(arguments: Sequence[str] | None = None) -> int:
    given, settings = _parser().parse_known_args(arguments)
    if "--total-steps" not in settings:
        settings += ["--total-steps", ENDLESS]
    where = machine()
    try:
        found, updates = measure(given.minutes, settings)
    except (ReskpnError, subprocess.TimeoutExpired) as error:
        print(f"memory: {error}", file=sys.stderr)
        return error.exit_code if isinstance(error, ReskpnError) else 1
    for line in (*describe(where), f"{given.minutes:g} minutes, {updates:,} updates", "", *table(found)):
        print(line)
    if given.json:
        content = {name: asdict(grown) for name, grown in found.items()}
        record = {"machine": where, "options": settings, "updates": updates, "services": content}
        given.json.write_text(json.dumps(record, indent=2) + "\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.memory",
        description="Resident memory of learner and actors over a real run. Further options are settings of the run.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--minutes", type=float, default=30.0, metavar="M", help="how long to watch")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    return parser


if __name__ == "__main__":
    sys.exit(main())
