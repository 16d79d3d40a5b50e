"""One run of the race: an entrant launched, given its time, stopped, and its curve kept."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.processes import ROOT, bare_environment
from benchmarks.race.entrants import Entrant, Run
from benchmarks.race.records import RaceResult
from benchmarks.race.wall import curve_of
from common.errors import ProcessError, SettingsError
from common.runtime import CACHE_VARIABLE
from reskpn.study.writing import origin

CLOSE_S = 60.0
"""Seconds that an entrant has to close its files after it was asked to stop."""

LAST_LINES = 6


def race(entrant: Entrant, task: str, seed: int, minutes: float, cores: int) -> RaceResult:
    """Give an entrant so many minutes from the launch of its process, and read what it has learned by when.

    Raises:
        SettingsError: this process may not use as many cores.
        ProcessError: the entrant is not installed, or ended before its time.
        LogReadError: what it leaves cannot be read.
    """
    usable = sorted(os.sched_getaffinity(0))
    if not 0 < cores <= len(usable):
        raise SettingsError(f"--cores {cores}: this process may use {len(usable)}; give a number from 1 to that")
    with tempfile.TemporaryDirectory(prefix="reskpn-race-") as folder:
        run = Run(task, seed, Path(folder))
        command = entrant.command(run)
        load = os.getloadavg()[0]
        output, launched_s = _launch(command, usable[:cores], Path(folder), minutes * 60)
        about, reports = entrant.progress(run, output, launched_s)
    made = origin()
    return RaceResult(
        entrant=entrant.name,
        given=entrant.given,
        task=task,
        seed=seed,
        identity=entrant.identity(task),
        minutes=minutes,
        cores=cores,
        settings=about["settings"],
        versions=about["versions"],
        curve=curve_of(reports, minutes * 60),
        machine=made["machine"],
        load=round(load, 2),
        commit=made["commit"],
        finished_at=made["finished_at"],
    )


def _launch(command: list[str], cores: list[int], folder: Path, duration_s: float) -> tuple[list[str], float]:
    """Run it for so long on these cores; the lines of its standard output, and when it was launched (epoch)."""
    environment = bare_environment() | {
        CACHE_VARIABLE: str(folder / "cache"),
        "PYTHONPATH": str(ROOT),
        "JAX_PLATFORMS": "cpu",
    }
    out, err = folder / "stdout", folder / "stderr"
    with out.open("wb") as stdout, err.open("wb") as stderr:
        launched_s, began_s = time.time(), time.monotonic()
        with _only_on(cores):
            process = subprocess.Popen(
                command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr
            )
        try:
            process.wait(timeout=duration_s)
        except subprocess.TimeoutExpired:
            _stop(process)
        else:
            words = (out.read_text("utf-8", "replace") + err.read_text("utf-8", "replace")).strip().splitlines()
            raise ProcessError(
                f"{' '.join(command)} ended after {time.monotonic() - began_s:.0f} s of {duration_s:.0f} with exit "
                f"code {process.returncode}; its last words:\n" + "\n".join(f"  {line}" for line in words[-LAST_LINES:])
            )
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
    return out.read_text("utf-8", "replace").splitlines(), launched_s


@contextmanager
def _only_on(cores: Collection[int]) -> Iterator[None]:
    """Processes that are launched in this block run on these cores."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _stop(process: subprocess.Popen[bytes]) -> None:
    """Ask it to stop as Ctrl-C does, and wait; kill it where it does not."""
    for number in (signal.SIGINT, signal.SIGKILL):
        process.send_signal(number)
        try:
            process.wait(timeout=CLOSE_S)
            return
        except subprocess.TimeoutExpired:
            continue
