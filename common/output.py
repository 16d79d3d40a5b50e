"""Output that may close while the process goes on: a pipe whose reader ends, a terminal that is closed."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Callable
from typing import TextIO

_SHOW_CURSOR = "\x1b[?25h"


class Output(io.TextIOBase):
    """Writes to a stream until that closes or nobody wants it any more; from then on, nowhere.

    So `reskpn train | head -1` ends the output, not the run.

    Args:
        stream: where to; None where there is no such stream.
        unwanted: asked before every write.
    """

    def __init__(self, stream: TextIO | None, unwanted: Callable[[], bool] = lambda: False) -> None:
        self._stream = stream
        self._unwanted = unwanted

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return "utf-8" if self._stream is None else self._stream.encoding

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def write(self, text: str) -> int:
        if self._stream is not None and self._unwanted():
            self._put(_SHOW_CURSOR)  # a live display hides it
            self._stream = None
        self._put(text)
        return len(text)

    def flush(self) -> None:
        self._put("")

    def _put(self, text: str) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):  # ValueError: the stream object itself was closed
            forget(self._stream)
            self._stream = None


def run_output(stopped: Callable[[], bool]) -> Output:
    """This process's standard output, for the lines about a run.

    Args:
        stopped: whether the run was asked to stop.
    """
    stream, parent = sys.stdout, os.getppid()
    on_terminal = stream is not None and stream.isatty()

    def left_alone() -> bool:
        # A second Ctrl-C ends `reskpn train` at once: the terminal is the shell's again, while the learner still closes
        # its log.
        return on_terminal and stopped() and os.getppid() != parent

    return Output(stream, left_alone)


def say(text: str, stream: TextIO | None = None) -> None:
    """Print a line of a service (default: on standard output); where that is closed, nothing, from then on."""
    try:
        print(text, file=stream, flush=True)
    except (OSError, ValueError):
        forget(stream or sys.stdout)


def forget(stream: TextIO) -> None:
    """Lead the stream's descriptor nowhere: the interpreter writes what the stream still holds when it ends."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
