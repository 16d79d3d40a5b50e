"""Items made ahead in a thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from common.runs.read_ahead import read_ahead

DEADLINE_S = 10.0


def names() -> set[str]:
    return {thread.name for thread in threading.enumerate()}


def test_the_same_items_in_the_same_order() -> None:
    """Also where there are many more than are made in advance."""
    with read_ahead(iter(range(100)), depth=3) as items:
        assert list(items) == list(range(100))
    assert "read-ahead" not in names()


def test_an_error_comes_in_its_place() -> None:
    """After the items that were made before it."""

    def broken() -> Iterator[int]:
        yield 1
        raise ValueError("here")

    with read_ahead(broken()) as items:
        assert next(items) == 1
        with pytest.raises(ValueError, match="here"):
            next(items)


def test_works_while_the_consumer_does_not() -> None:
    """Up to its depth and one in hand, and not further; leaving early ends the thread."""
    made: list[int] = []
    third = threading.Event()

    def counted() -> Iterator[int]:
        for number in range(100):
            made.append(number)
            if number == 2:
                third.set()
            yield number

    with read_ahead(counted(), depth=2):
        assert third.wait(DEADLINE_S)
    assert made == [0, 1, 2]
    assert "read-ahead" not in names()
