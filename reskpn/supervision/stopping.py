"""Stopping a service: by a signal, or with its supervisor."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stopping(*, supervised: bool) -> Iterator[threading.Event]:
    """An event that SIGINT, SIGTERM and SIGHUP set; a second SIGINT or SIGTERM ends the process at once.

    SIGHUP, which a terminal sends when it is closed, has no effect where it is ignored (`nohup`).

    A supervised process also stops when its standard input ends, which happens however its supervisor ends.
    """
    stop = threading.Event()

    def on_signal(number: int, _frame: object) -> None:
        # A terminal that closes may send SIGHUP twice: the kernel, and the shell to its jobs.
        if stop.is_set() and number != signal.SIGHUP:
            os._exit(128 + number)
        stop.set()

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    if supervised:
        threading.Thread(target=_wait_for_end, args=(stop,), name="supervisor-watch", daemon=True).start()
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _wait_for_end(stop: threading.Event) -> None:
    # Not sys.stdin: its lock, held by this thread at exit, would abort the interpreter.
    while os.read(0, 4096):
        pass
    stop.set()
