"""An iterator that works in a thread of its own, a few items ahead of whoever consumes it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")

_POLL_S = 0.1


@dataclass(frozen=True)
class _End(Generic[Item]):
    """The last thing in the queue: how the iterator ended."""

    error: BaseException | None


@contextmanager
def ahead(items: Iterator[Item], depth: int = 2) -> Iterator[Iterator[Item]]:
    """The same items, with up to `depth` of them made in advance; what `items` raises comes out in its place.

    The thread ends with the block, also where not all was consumed.
    """
    made: queue.Queue[Item | _End[Item]] = queue.Queue(depth)
    left = threading.Event()

    def put(item: Item | _End[Item]) -> None:
        while not left.is_set():
            try:
                return made.put(item, timeout=_POLL_S)
            except queue.Full:
                continue

    def work() -> None:
        error: BaseException | None = None
        try:
            for item in items:
                put(item)
                if left.is_set():
                    return
        except BaseException as caught:
            error = caught
        put(_End(error))

    thread = threading.Thread(target=work, name="read-ahead", daemon=True)
    thread.start()
    try:
        yield _taken(made)
    finally:
        left.set()
        thread.join()


def _taken(made: queue.Queue[Item | _End[Item]]) -> Iterator[Item]:
    while True:
        item = made.get()
        if isinstance(item, _End):
            if item.error is not None:
                raise item.error
            return
        yield item
