"""Curves for Weights & Biases and trackio, sent from a thread: no run waits for them or ends with them."""

from __future__ import annotations

import contextlib
import io
import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

PROJECT = "reskpn"

MOST_WAITING = 4096
"""Points, of one update each, that wait for a tracker; further ones are left out."""

CLOSE_S = 20.0
"""Seconds that the end of a run waits for a tracker to send what is left."""


@dataclass(frozen=True)
class TrackedRun:
    """The run as a tracker knows it: resumed under the same name, it is the same run there."""

    name: str
    settings: Mapping[str, object]
    run_dir: Path


class Sink(Protocol):
    """A tracker's own run."""

    def log(self, env_steps: int, values: Mapping[str, float]) -> None: ...
    def finish(self) -> None: ...


class Tracker:
    """Passes points on to a sink, which is opened and used in a thread of its own.

    Whatever goes wrong there, and it may be slow or raise anything, ends this tracker with one call of `warn`.
    """

    def __init__(self, name: str, open_sink: Callable[[], Sink], warn: Callable[[str], None]) -> None:
        self._name = name
        self._open_sink = open_sink
        self._warn = warn
        self._points: queue.SimpleQueue[tuple[int, Mapping[str, float]] | None] = queue.SimpleQueue()
        self._left_out = 0
        self._ended = False
        self._thread = threading.Thread(target=self._send, name=f"tracker-{name}", daemon=True)
        self._thread.start()

    def add(self, env_steps: int, values: Mapping[str, float]) -> None:
        """Have points sent; never waits."""
        if self._ended:
            return
        if self._points.qsize() < MOST_WAITING:
            self._points.put((env_steps, dict(values)))
            return
        self._left_out += 1
        if self._left_out == 1:
            self._warn(f"{self._name} is too slow: points are left out there; the log has all numbers")

    def close(self) -> None:
        """Have the rest sent, within a limit. Does nothing the second time."""
        if self._ended:
            return
        self._ended = True
        self._points.put(None)
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self._warn(f"{self._name} did not finish within {CLOSE_S:g} s: its last points may be missing there")

    def _send(self) -> None:
        try:
            sink = self._open_sink()
            while (points := self._points.get()) is not None:
                sink.log(*points)
            sink.finish()
        # A tracker's package raises what it likes, and not even the end of its own process may be that of the run.
        except BaseException as error:
            self._ended = True
            reason = " ".join(str(error).split())[:300] or type(error).__name__
            self._warn(f"{self._name} ended: {reason}; the run goes on, and its log has all numbers")


def make_tracker(name: str, run: TrackedRun, warn: Callable[[str], None]) -> Tracker:
    """The tracker of that name."""
    return Tracker(name, lambda: _SINKS[name](run), warn)


class _Wandb:
    """A run of Weights & Biases; `WANDB_MODE=offline` keeps it on this machine."""

    def __init__(self, run: TrackedRun) -> None:
        wandb: Any = import_module("wandb")
        self._run = wandb.init(
            project=PROJECT,
            id=run.name,
            name=run.name,
            resume="allow",
            config=dict(run.settings),
            dir=str(run.run_dir),
            # The terminal is the run's own display.
            settings=wandb.Settings(silent=True, console="off"),
        )
        # Evaluations come later than the updates of the same step, which its own counter of steps does not allow.
        self._run.define_metric("env_steps", hidden=True)
        self._run.define_metric("*", step_metric="env_steps")

    def log(self, env_steps: int, values: Mapping[str, float]) -> None:
        self._run.log({**values, "env_steps": env_steps})

    def finish(self) -> None:
        self._run.finish()


class _Trackio:
    """A run of trackio, in its folder of this user; `trackio show` draws it."""

    def __init__(self, run: TrackedRun) -> None:
        self._trackio: Any = import_module("trackio")
        with _quiet():
            self._run = self._trackio.init(
                project=PROJECT, name=run.name, resume="allow", config=dict(run.settings), embed=False
            )

    def log(self, env_steps: int, values: Mapping[str, float]) -> None:
        self._run.log(dict(values), step=env_steps)

    def finish(self) -> None:
        with _quiet():
            self._run.finish()


def _quiet() -> contextlib.AbstractContextManager[object]:
    """Hold back what trackio prints; the run's display, which has its own stream since its start, goes on."""
    return contextlib.redirect_stdout(io.StringIO())


_SINKS: dict[str, Callable[[TrackedRun], Sink]] = {"wandb": _Wandb, "trackio": _Trackio}
