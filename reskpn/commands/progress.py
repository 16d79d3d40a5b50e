"""Progress bars of commands that read a recorded run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


def progress_bar() -> Progress:
    """A bar on the screen, beside what is printed; nothing of it where there is no screen."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True, highlight=False),
        transient=True,
    )


@contextmanager
def recomputing(total: int | None) -> Iterator[Callable[[int], None]]:
    """A function to call with each version that was recomputed; a bar is on the screen from the first one on."""
    with ExitStack() as stack:
        bar = progress_bar()
        task = bar.add_task("recomputing", total=total)

        def on_update(version: int) -> None:
            if not bar.live.is_started:
                stack.enter_context(bar)
            bar.update(task, completed=version)

        yield on_update
