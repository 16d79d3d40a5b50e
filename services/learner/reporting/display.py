"""The display of a run: a live line on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from typing import IO, Protocol, cast

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from common.output import Output
from common.wire.report import Progress

PLAIN_PERIOD_S = 5.0

BAR_WIDTH = 36
BESIDE_BAR = 30
"""Characters of phase, share done and time left, with the spaces between them."""

LEAST_NEEDED = ("staleness", "centres", "diverged", "actors", "reward", "steps", "steps/s", "return")
"""Numbers that a narrow terminal does without, in this order."""


class Display(Protocol):
    """Shows a run; `note` is for what should stay on the screen."""

    def show(self, progress: Progress) -> None: ...
    def note(self, text: str) -> None: ...
    def close(self) -> None: ...


def make_display(title: str, output: Output | None = None) -> Display:
    """A live display where the output (default: standard output) is a terminal, plain lines otherwise."""
    console = Console(file=cast(IO[str] | None, output), highlight=False)
    return LiveDisplay(console, title) if console.is_terminal else PlainDisplay(console, title)


class PlainDisplay:
    """A line when the phase changes and every few seconds."""

    def __init__(self, console: Console, title: str) -> None:
        self._console = console
        self._phase = ""
        self._due_s = 0.0
        self.note(title)

    def show(self, progress: Progress) -> None:
        now = time.monotonic()
        if progress.phase == self._phase and now < self._due_s:
            return
        self._phase, self._due_s = progress.phase, now + PLAIN_PERIOD_S
        numbers = (f"{name} {value}" for name, value in _numbers(progress).items())
        self.note(" | ".join(part for part in (progress.phase, *numbers, progress.text) if part))

    def note(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, markup=False)

    def close(self) -> None:
        """Nothing to do: there is nothing that is drawn over."""


class LiveDisplay:
    """A bar and the numbers, redrawn in place."""

    def __init__(self, console: Console, title: str) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=4, transient=False)
        self.note(title)
        self._live.start()

    def show(self, progress: Progress) -> None:
        bar = Table.grid(padding=(0, 1))
        done = f"{progress.env_steps / max(1, progress.total_steps):4.0%}"
        bar.add_row(
            Text(f"{progress.phase:<10}", style="bold"),
            ProgressBar(
                total=progress.total_steps,
                completed=progress.env_steps,
                width=max(4, min(BAR_WIDTH, self._console.width - BESIDE_BAR)),
            ),
            Text(done),
            Text(_duration(progress.remaining_s)),
        )
        numbers = Text(fitting(_numbers(progress), self._console.width), style="cyan")
        self._live.update(Group(bar, numbers, Text(progress.text, style="dim")))

    def note(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, markup=False)

    def close(self) -> None:
        self._live.stop()


def fitting(numbers: dict[str, str], width: int) -> str:
    """As many of the numbers as fit into a line of that width, in their order, without the least needed ones."""
    kept = dict(numbers)
    for name in LEAST_NEEDED:
        if len(_joined(kept)) > width:
            kept.pop(name, None)
    return _joined(kept)


def _joined(numbers: dict[str, str]) -> str:
    return " · ".join(f"{name} {value}" for name, value in numbers.items())


def _numbers(progress: Progress) -> dict[str, str]:
    numbers = {
        "update": f"{progress.version}/{progress.updates}",
        "steps": f"{progress.env_steps:,}",
        "steps/s": "-" if progress.steps_per_s is None else f"{progress.steps_per_s:,.0f}",
        "return": "-" if progress.train_return is None else f"{progress.train_return:,.1f}",
        "reward": "-" if progress.step_reward is None else f"{progress.step_reward:,.2f}",
        "staleness": f"{progress.staleness:g}",
        "actors": f"{progress.actors}/{progress.slots}",
    }
    if progress.diverged:
        numbers["diverged"] = f"{progress.diverged:,}"
    if progress.capacity:
        numbers["centres"] = "-" if progress.centres is None else f"{progress.centres}/{progress.capacity}"
    return numbers


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "--:-- left"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes:d}:{rest:02d} left"
