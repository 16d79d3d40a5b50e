"""Sessions on loopback for the tests of the services."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from common.wire.endpoint import free_port
from common.wire.session import Session, open_session

DEADLINE_S = 15.0
MAX_MESSAGE = 1 << 20


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def sessions(endpoint: str) -> Iterator[Callable[..., Session]]:
    """Opens sessions that are closed after the test: `sessions(listen=True)`, or `sessions()` to connect to it."""
    with ExitStack() as stack:

        def make(*, listen: bool = False, connect_timeout_s: float | None = DEADLINE_S) -> Session:
            ends: dict[str, Any] = {"listen": [endpoint]} if listen else {"connect": [endpoint]}
            return stack.enter_context(
                open_session(**ends, connect_timeout_s=connect_timeout_s, max_message_size=MAX_MESSAGE)
            )

        yield make


@pytest.fixture
def until() -> Callable[[Callable[[], bool]], None]:
    """Waits until a condition that other threads bring about holds; fails after a deadline."""
    pause = threading.Event()

    def wait(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, "what was waited for did not happen in time"
            pause.wait(0.005)

    return wait
