"""What a person sees while a run goes on: a live line on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

PLAIN_PERIOD_S = 5.0


@dataclass(frozen=True)
class Status:
    """The run at one moment. `text` says what it waits for; None where a number is not known yet.

    `train_return` is of the newest episodes that ended, `step_reward` of every step of the newest batch.
    """

    phase: str
    text: str
    version: int
    updates: int
    env_steps: int
    total_steps: int
    steps_per_s: float | None
    train_return: float | None
    step_reward: float | None
    staleness: float
    centres: int | None
    capacity: int
    actors: int
    slots: int

    @property
    def remaining_s(self) -> float | None:
        if not self.steps_per_s:
            return None
        return (self.total_steps - self.env_steps) / self.steps_per_s


class Display(Protocol):
    """Shows a run; `note` is for what should stay on the screen."""

    def show(self, status: Status) -> None: ...
    def note(self, text: str) -> None: ...
    def close(self) -> None: ...


def make_display(title: str) -> Display:
    """A live display on a terminal, plain lines otherwise."""
    console = Console(highlight=False)
    return LiveDisplay(console, title) if console.is_terminal else PlainDisplay(console, title)


class PlainDisplay:
    """A line when the phase changes and every few seconds."""

    def __init__(self, console: Console, title: str) -> None:
        self._console = console
        self._phase = ""
        self._due_s = 0.0
        self.note(title)

    def show(self, status: Status) -> None:
        now = time.monotonic()
        if status.phase == self._phase and now < self._due_s:
            return
        self._phase, self._due_s = status.phase, now + PLAIN_PERIOD_S
        numbers = (f"{name} {value}" for name, value in _numbers(status).items())
        self.note(" | ".join(part for part in (status.phase, *numbers, status.text) if part))

    def note(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, markup=False)

    def close(self) -> None:
        """Nothing to put back."""


class LiveDisplay:
    """A bar and the numbers, redrawn in place."""

    def __init__(self, console: Console, title: str) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=4, transient=False)
        self.note(title)
        self._live.start()

    def show(self, status: Status) -> None:
        bar = Table.grid(padding=(0, 1))
        done = f"{status.env_steps / max(1, status.total_steps):4.0%}"
        bar.add_row(
            Text(f"{status.phase:<10}", style="bold"),
            ProgressBar(total=status.total_steps, completed=status.env_steps, width=36),
            Text(done),
            Text(_duration(status.remaining_s)),
        )
        numbers = Text(" · ".join(f"{name} {value}" for name, value in _numbers(status).items()), style="cyan")
        self._live.update(Group(bar, numbers, Text(status.text, style="dim")))

    def note(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, markup=False)

    def close(self) -> None:
        self._live.stop()


def _numbers(status: Status) -> dict[str, str]:
    numbers = {
        "update": f"{status.version}/{status.updates}",
        "steps": f"{status.env_steps:,}",
        "steps/s": "-" if status.steps_per_s is None else f"{status.steps_per_s:,.0f}",
        "return": "-" if status.train_return is None else f"{status.train_return:,.1f}",
        "reward": "-" if status.step_reward is None else f"{status.step_reward:,.2f}",
        "staleness": f"{status.staleness:g}",
        "actors": f"{status.actors}/{status.slots}",
    }
    if status.capacity:
        numbers["centres"] = "-" if status.centres is None else f"{status.centres}/{status.capacity}"
    return numbers


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "--:-- left"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes:d}:{rest:02d} left"
