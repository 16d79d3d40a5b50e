"""Making the runs that are missing, several at a time, each in a process."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

from common.config.settings import RunSettings
from common.errors import LogWriteError, ProcessError
from reskpn.study.planning import Trial
from reskpn.study.scoring import area_of, final_of
from reskpn.study.store import Store

TELL_S = 60.0
"""How often a person is told what is in work."""

Say = Callable[[str], None]
Runner = Callable[[RunSettings, Path, "Work"], None]


class Work:
    """One run under way: how far it is, and its process, so that it can be ended."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self.steps = 0
        self.process: subprocess.Popen[str] | None = None
        self.began_s = time.monotonic()

    def stop(self) -> None:
        """End the run's process."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()


@dataclass
class Progress:
    """Steps made and to make, for the time that is left."""

    total_steps: int
    began_s: float = field(default_factory=time.monotonic)
    finished_steps: int = 0

    def left(self, under_way: int) -> str:
        """The time left at the pace so far, in words. `under_way`: steps of runs that are not finished."""
        made = self.finished_steps + under_way
        if not made:
            return "time left unknown"
        seconds = (time.monotonic() - self.began_s) / made * (self.total_steps - made)
        minutes = round(seconds / 60)
        return f"{minutes // 60} h {minutes % 60} min left" if minutes >= 60 else f"{minutes} min left"


def run_missing(trials: Sequence[Trial], store: Store, *, jobs: int, say: Say, runner: Runner) -> int:
    """Make the trials whose results are missing; returns how many were made.

    A run that fails is reported, and the others go on.

    Raises:
        LogWriteError: a result could not be written; no further run was begun.
        ProcessError: runs failed.
    """
    missing = list({trial.identity: trial for trial in trials if store.find(trial.settings) is None}.values())
    return _Queue(missing, store, jobs, say, runner).work() if missing else 0


class _Queue:
    """The missing runs, `jobs` of them in work."""

    def __init__(self, missing: list[Trial], store: Store, jobs: int, say: Say, runner: Runner) -> None:
        self._missing = missing
        self._store = store
        self._jobs = jobs
        self._say = say
        self._runner = runner
        self._waiting = list(missing)
        self._under_way: dict[Future[None], Work] = {}
        self._progress = Progress(sum(trial.settings.total_steps for trial in missing))
        self._failed: list[str] = []
        self._done = 0

    def work(self) -> int:
        self._say(f"{len(self._missing)} runs to make, {self._progress.total_steps:,} steps, {self._jobs} at a time")
        with ThreadPoolExecutor(self._jobs) as pool:
            try:
                self._work(pool)
            finally:
                for work in self._under_way.values():
                    work.stop()
        if self._failed:
            raise ProcessError(
                f"{len(self._failed)} of {len(self._missing)} runs failed: {'; '.join(self._failed)}. The results of "
                "the others are kept; give the command again to try the failed ones once more"
            )
        return self._done

    def _work(self, pool: ThreadPoolExecutor) -> None:
        told_s = time.monotonic()
        while self._waiting or self._under_way:
            while self._waiting and len(self._under_way) < self._jobs:
                self._begin(pool, self._waiting.pop(0))
            ended, _ = wait(self._under_way, timeout=1.0, return_when=FIRST_COMPLETED)
            for future in ended:
                self._end(future)
            if time.monotonic() - told_s > TELL_S and self._under_way:
                told_s = time.monotonic()
                self._tell()

    def _begin(self, pool: ThreadPoolExecutor, trial: Trial) -> None:
        if self._store.reread(trial.settings) is not None:  # another process has made it meanwhile
            self._progress.finished_steps += trial.settings.total_steps
            return
        work = Work(trial)
        self._under_way[pool.submit(self._runner, trial.settings, self._store.path(trial.settings), work)] = work

    def _end(self, future: Future[None]) -> None:
        work = self._under_way.pop(future)
        trial = work.trial
        self._progress.finished_steps += trial.settings.total_steps
        try:
            future.result()
        except LogWriteError:
            self._waiting.clear()
            raise
        except ProcessError as error:
            self._failed.append(f"{trial} ({error})")
            self._say(f"failed: {trial}: {error}")
            return
        self._done += 1
        result = self._store.reread(trial.settings)
        assert result is not None  # the runner has written it
        self._say(
            f"[{self._done + len(self._failed)}/{len(self._missing)}] {trial}: return {final_of(result):,.1f}, mean "
            f"over the run {area_of(result):,.1f}, in {time.monotonic() - work.began_s:.0f} s; "
            f"{self._progress.left(self._steps_under_way())}"
        )

    def _tell(self) -> None:
        running = "; ".join(f"{work.trial} {self._percent(work)}%" for work in self._under_way.values())
        self._say(f"  in work: {running}; {self._progress.left(self._steps_under_way())}")

    def _steps_under_way(self) -> int:
        return sum(work.steps for work in self._under_way.values())

    @staticmethod
    def _percent(work: Work) -> int:
        return 100 * work.steps // work.trial.settings.total_steps


def check_exit(code: int, errors: Sequence[str]) -> None:
    """Nothing for exit code 0; else the error that a run's process ended with."""
    if code == 0:
        return
    said = " ".join((errors[-1] if errors else "").split()) or f"its process ended with code {code}"
    if code == LogWriteError.exit_code:
        raise LogWriteError(said)
    raise ProcessError(said)
