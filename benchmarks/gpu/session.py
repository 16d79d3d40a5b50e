"""Cases run one after the other within a budget of time; what each one tells is kept at once."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import IO, Literal

from benchmarks.gpu.cases import Case, Scale
from benchmarks.gpu.rows import Row, row_in
from benchmarks.processes import ROOT, bare_environment
from common.device_memory import ON_DEMAND, PLATFORMS, with_share

LEAST_S = 15.0
"""A case is not begun with less time than this: it would end before its first figure."""

GRACE_S = 12.0
"""Time in which a case that is stopped, and the processes that it started, may end by themselves."""

LAST_LINES = 6
"""Lines of a failed process that are kept as its error."""

State = Literal["done", "failed", "stopped", "not run"]


@dataclass
class Outcome:
    """What became of a case. `reason` says why it failed, was stopped or was not run."""

    name: str
    kind: str
    state: State = "not run"
    seconds: float = 0.0
    reason: str = ""
    rows: list[Row] = field(default_factory=list)


Clock = Callable[[], float]


def run_all(
    cases: Sequence[Case],
    scale: Scale,
    *,
    cpu: bool,
    budget_s: float,
    keep: Callable[[list[Outcome]], None],
    say: Callable[[str], None] = lambda text: None,
    clock: Clock = time.monotonic,
) -> list[Outcome]:
    """Run the cases in their order; returns the outcomes of all of them.

    Args:
        cpu: keep JAX off the GPU in every case.
        budget_s: seconds for all of them together.
        keep: called with all outcomes whenever there is something new, and at the beginning.
        say: called with a sentence after each case.
        clock: seconds.
    """
    until = clock() + budget_s
    outcomes = [Outcome(case.name, case.kind) for case in cases]
    keep(outcomes)
    for case, outcome in zip(cases, outcomes, strict=True):
        left = until - clock()
        if left < LEAST_S:
            outcome.reason = f"the budget of {budget_s:g} s was used up"
        else:
            limit_s = min(case.limit_s * scale.patience, left)
            try:
                _run(case, outcome, scale, cpu=cpu, limit_s=limit_s, keep=lambda: keep(outcomes))
            finally:
                keep(outcomes)
        say(f"{outcome.name}: {outcome.state} in {outcome.seconds:.0f} s")
    keep(outcomes)
    return outcomes


def environment_of(case: Case, scale: Scale, *, cpu: bool) -> dict[str, str]:
    """The environment of a case's process: no settings, no reserved memory, and the GPU only where it is measured."""
    given = with_share({**bare_environment(), **scale.environment}, ON_DEMAND)
    return {**given, PLATFORMS: "cpu"} if cpu or case.on_cpu else given


def _run(case: Case, outcome: Outcome, scale: Scale, *, cpu: bool, limit_s: float, keep: Callable[[], None]) -> None:
    began_s = time.monotonic()
    outcome.state, outcome.reason = "stopped", "it was at work when this was written"
    process = subprocess.Popen(
        [sys.executable, *case.words(scale)],
        cwd=ROOT,
        env=environment_of(case, scale, cpu=cpu),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    assert process.stdout is not None
    last: list[str] = []
    try:
        for line in _Lines(process.stdout, began_s + limit_s):
            row = row_in(line)
            if row is None:
                last = [*last, line.rstrip()][-LAST_LINES:]
                continue
            outcome.rows.append(row)
            keep()
        _conclude(process, outcome, began_s + limit_s, limit_s, last)
    except KeyboardInterrupt:
        outcome.state, outcome.reason = "stopped", "with the whole command"
        raise
    finally:
        _end(process)
        outcome.seconds = time.monotonic() - began_s


class _Lines:
    """The lines of a process as they come, up to its end or a point in time."""

    def __init__(self, output: IO[str], until: float) -> None:
        self._until = until
        self._queue: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, args=(output,), daemon=True).start()

    def __iter__(self) -> _Lines:
        return self

    def __next__(self) -> str:
        try:
            line = self._queue.get(timeout=max(0.0, self._until - time.monotonic()))
        except queue.Empty:
            raise StopIteration from None
        if line is None:
            raise StopIteration
        return line

    def _read(self, output: IO[str]) -> None:
        for line in output:
            self._queue.put(line)
        self._queue.put(None)


def _conclude(
    process: subprocess.Popen[str], outcome: Outcome, until: float, limit_s: float, last: Sequence[str]
) -> None:
    """Say how the process ended; `until` is when it would have been stopped."""
    try:
        code = process.wait(max(0.1, until - time.monotonic()))
    except subprocess.TimeoutExpired:
        outcome.state, outcome.reason = "stopped", f"after {limit_s:.0f} s, its limit"
        return
    if code == 0 and outcome.rows:
        outcome.state, outcome.reason = "done", ""
        return
    how = f"exit code {code}" if code >= 0 else f"signal {-code}"
    outcome.state, outcome.reason = "failed", "\n".join([how, *last])


def _end(process: subprocess.Popen[str]) -> None:
    """End the process and what it has started: `reskpn train` ends its own in good order when it is asked to."""
    deadline = time.monotonic() + GRACE_S
    _signal_group(process, signal.SIGTERM)
    while _signal_group(process, 0) and time.monotonic() < deadline:
        process.poll()  # a process that has ended belongs to its group until it is asked for its exit code
        time.sleep(0.05)
    _signal_group(process, signal.SIGKILL)
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _signal_group(process: subprocess.Popen[str], number: int) -> bool:
    """Send a signal to all processes of the group; False where none is left."""
    try:
        os.killpg(process.pid, number)
    except (ProcessLookupError, PermissionError):
        return False
    return True
