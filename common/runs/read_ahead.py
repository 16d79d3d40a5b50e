"""Read-ahead: an iterator that works in a thread of its own, a few items ahead of its consumer."""

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
    """The last entry of the queue: the error that ended the iterator, if any."""

    error: BaseException | None


@contextmanager
def read_ahead(items: Iterator[Item], depth: int = 2) -> Iterator[Iterator[Item]]:
    """The same items, with up to `depth` of them produced in advance; an error of `items` is raised in its place.

    The thread ends with the block, also where not all was consumed.
    """
    produced: queue.Queue[Item | _End[Item]] = queue.Queue(depth)
    abandoned = threading.Event()

    def put(item: Item | _End[Item]) -> None:
        # A plain put would wait for ever on a consumer that has left.
        while not abandoned.is_set():
            try:
                return produced.put(item, timeout=_POLL_S)
            except queue.Full:
                continue

    def work() -> None:
        error: BaseException | None = None
        try:
            for item in items:
                put(item)
                if abandoned.is_set():
                    return
        except BaseException as caught:
            error = caught
        put(_End(error))

    thread = threading.Thread(target=work, name="read-ahead", daemon=True)
    thread.start()
    try:
        yield _consume(produced)
    finally:
        abandoned.set()
        thread.join()


def _consume(produced: queue.Queue[Item | _End[Item]]) -> Iterator[Item]:
    while True:
        item = produced.get()
        if isinstance(item, _End):
            if item.error is not None:
                raise item.error
            return
        yield item
