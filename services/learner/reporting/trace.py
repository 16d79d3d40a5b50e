"""A trace of some updates by JAX's profiler: what ran when, on the learner's threads and on its devices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import TracebackType

import jax

from common.trace_plan import TracePlan

TRACE = "trace"
"""Folder of the traces in the directory of a run."""

_NO_PYTHON_CALLS = 0


def phase(name: str) -> AbstractContextManager[None]:
    """Names what the learner's loop does meanwhile, for a trace; names are those of `seconds` in `/update`."""
    return jax.profiler.TraceAnnotation(name)


class UpdateTrace:
    """Traces the updates that are planned, if any are. Whatever becomes of the trace, the run goes on.

    Args:
        plan: None to trace nothing.
        folder: where the files go.
        tell: called with level, name and text of an event.
    """

    def __init__(self, plan: TracePlan | None, folder: Path, tell: Callable[[str, str, str], None]) -> None:
        self._plan = plan
        self._folder = folder
        self._tell = tell
        self._made = 0
        self._versions: list[int] = []
        self._running = False

    @classmethod
    def none(cls) -> UpdateTrace:
        """Traces nothing."""
        return cls(None, Path(), lambda level, name, text: None)

    def __enter__(self) -> UpdateTrace:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Write a trace whose end the run did not reach."""
        if self._running:
            self._stop()
        elif self._plan is not None:
            text = f"no update was traced: the run ended before --trace {self._plan.written()} was due"
            self._tell("warning", "not_traced", text)

    @contextmanager
    def update(self, version: int) -> Iterator[None]:
        """Around all that the loop does for the update that leads to `version`."""
        if self._plan is not None and not self._running and self._plan.is_due(version, self._made):
            self._start()
        if self._running:
            self._versions.append(version)
        with jax.profiler.StepTraceAnnotation("update", step_num=version):
            yield
        self._made += 1
        if self._running and self._plan is not None and len(self._versions) == self._plan.count:
            self._stop()

    def _start(self) -> None:
        options = jax.profiler.ProfileOptions()
        # Every call of a Python function would hide what takes the time, and slow it down.
        options.python_tracer_level = _NO_PYTHON_CALLS
        try:
            self._folder.mkdir(exist_ok=True)
            jax.profiler.start_trace(self._folder, create_perfetto_trace=True, profiler_options=options)
        except (OSError, RuntimeError) as error:
            self._fail(error)
            return
        self._running = True

    def _stop(self) -> None:
        self._running = False
        try:
            jax.profiler.stop_trace()
        except (OSError, RuntimeError, ValueError) as error:
            self._fail(error)
            return
        self._plan = None
        path = max(self._folder.rglob("perfetto_trace.json.gz"), key=lambda found: found.stat().st_mtime)
        first, last = self._versions[0], self._versions[-1]
        which = f"version {first}" if first == last else f"versions {first} to {last}"
        self._tell("info", "traced", f"traced the updates to {which}: open {path} in https://ui.perfetto.dev")

    def _fail(self, error: Exception) -> None:
        self._plan = None
        self._tell("warning", "trace_failed", f"no trace was written to {self._folder}: {error}")
