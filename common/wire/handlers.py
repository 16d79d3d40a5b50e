"""Callbacks on Zenoh's threads: requests that are answered once, and the handling of errors there."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from common.errors import SessionError

OnError = Callable[[str, Exception], None]
"""(key, what a handler raised)."""


def log_error(key: str, error: Exception) -> None:
    """The default `OnError`: Python's logging, with the traceback."""
    logging.getLogger(__name__).error("a handler of %s failed", key, exc_info=error)


def guarded(key: str, callback: Callable[[Any], None], on_error: OnError) -> Callable[[Any], None]:
    """The callback, whose errors go to `on_error` and not to Zenoh."""

    def call(item: Any) -> None:
        try:
            callback(item)
        except Exception as error:
            on_error(key, error)

    return call


def check_size(key: str, data: bytes, allowed: int) -> None:
    """Raises `SessionError` for a message that the other side would not take."""
    if len(data) > allowed:
        raise SessionError(
            f"a message of {len(data):,} bytes on {key}; {allowed:,} are allowed: "
            "make rollouts smaller or raise the limit on both sides"
        )


class Request:
    """A question that waits for one answer, which any thread may give at any time.

    The asker's wait ends when the request is answered or dropped, or its handler raises.
    """

    __slots__ = ("_answer", "_answered", "key", "payload")

    def __init__(self, key: str, payload: bytes, answer: Callable[[bytes], None]) -> None:
        self.key = key
        self.payload = payload
        self._answer = answer
        self._answered = threading.Lock()

    def reply(self, data: bytes) -> None:
        """Answer; an asker that is gone or has stopped waiting is no error. `RuntimeError` the second time."""
        if not self._answered.acquire(blocking=False):
            raise RuntimeError(f"a request on {self.key} was answered twice")
        self._answer(data)
