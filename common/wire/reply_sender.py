"""Sends replies from threads of their own: a peer that does not read must not hold up handlers, the log, or others."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

MAX_THREADS = 32
MAX_WAITING = 1024
"""Replies that wait for a thread; one more is given up, which ends the wait of its asker."""

IDLE_S = 5.0
CLOSE_S = 0.5


class ReplySender:
    """Runs what may block for a while, in the order of submission, on as many threads as are blocked at once.

    A reply to a peer that does not read blocks until Zenoh gives the peer up, after `zenoh_settings.STALL_US`. A thread
    is started only when all are busy, so usually there is one; threads end when they have been idle.
    """

    def __init__(self, name: str, max_threads: int = MAX_THREADS, max_waiting: int = MAX_WAITING) -> None:
        self._name = name
        self._max_threads = max_threads
        self._max_waiting = max_waiting
        self._changed = threading.Condition()
        # Under the condition, from here
        self._waiting: deque[Callable[[], None]] = deque()
        self._threads = 0
        self._idle = 0
        self._sending = 0
        self._closed = False

    def submit(self, send: Callable[[], None]) -> bool:
        """Run `send`, which must not raise, as soon as a thread is free; False where it was given up. Never blocks."""
        with self._changed:
            if self._closed or len(self._waiting) >= self._max_waiting:
                return False
            self._waiting.append(send)
            if len(self._waiting) > self._idle and self._threads < self._max_threads:
                self._threads += 1
                # A daemon: what blocks it ends with the session, and must not keep the process.
                threading.Thread(target=self._run, name=f"replies {self._name}", daemon=True).start()
            else:
                self._changed.notify()
        return True

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """Take no more, and wait until what was submitted is sent, or for `timeout_s`."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._waiting and not self._sending, timeout_s)

    def _run(self) -> None:
        while (send := self._next()) is not None:
            send()
            with self._changed:
                self._sending -= 1
                self._changed.notify_all()

    def _next(self) -> Callable[[], None] | None:
        with self._changed:
            self._idle += 1
            there = self._changed.wait_for(lambda: self._waiting or self._closed, IDLE_S)
            self._idle -= 1
            if there and self._waiting:
                self._sending += 1
                return self._waiting.popleft()
            self._threads -= 1
            return None
