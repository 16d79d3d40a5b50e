"""Replies leave from threads of their own, as many as are blocked."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from queue import Queue

import pytest

from common.wire.reply_sender import ReplySender

DEADLINE_S = 15.0


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """What blocked sends wait for; opened at the end of a test."""
    opened = threading.Event()
    yield opened
    opened.set()


def test_a_peer_that_does_not_read_holds_up_nobody(gate: threading.Event) -> None:
    """Three replies that block, and others behind them: these are sent at once, in their order."""
    sender, sent = ReplySender("test"), Queue[int]()
    for _ in range(3):
        assert sender.submit(lambda: gate.wait(DEADLINE_S) and None)
    for number in range(5):
        assert sender.submit(lambda number=number: sent.put(number))
        assert sent.get(timeout=DEADLINE_S) == number


def test_at_the_bound_replies_wait_and_then_are_given_up(gate: threading.Event) -> None:
    """Two threads, both blocked, and room for one: the next is not taken; once they go on, the waiting one is sent."""
    sender, sent = ReplySender("test", max_threads=2, max_waiting=1), Queue[str]()
    blocked = Queue[None]()

    def block() -> None:
        blocked.put(None)
        gate.wait(DEADLINE_S)

    for _ in range(2):
        assert sender.submit(block)
        blocked.get(timeout=DEADLINE_S)
    assert sender.submit(lambda: sent.put("waited"))
    assert not sender.submit(lambda: sent.put("given up"))
    gate.set()
    assert sent.get(timeout=DEADLINE_S) == "waited"


def test_closing_sends_what_was_submitted() -> None:
    """And takes no more."""
    sender, sent = ReplySender("test"), Queue[int]()
    for number in range(20):
        sender.submit(lambda number=number: sent.put(number))
    sender.close(DEADLINE_S)
    assert sent.qsize() == 20
    assert not sender.submit(lambda: sent.put(99))


def test_closing_does_not_wait_for_a_peer_that_does_not_read(gate: threading.Event) -> None:
    """No longer than it is told to."""
    sender = ReplySender("test")
    sender.submit(lambda: gate.wait(DEADLINE_S) and None)
    sender.close(0.01)
    assert not gate.is_set()
