"""A learner's hub and its actors for the tests of the hub."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from hub_sides import Actor, Learner

from common.errors import SessionError
from common.wire.session import Session


@pytest.fixture
def learners(sessions: Callable[..., Session], tmp_path: Path) -> Iterator[Callable[..., Learner]]:
    """Makes a learner: `learners(actors=1)`; its log is closed after its session."""
    with ExitStack() as stack:

        def make(**changes: Any) -> Learner:
            session = sessions(listen=True)
            learner = Learner(session, tmp_path / "log", **changes)
            stack.callback(learner.writer.close)
            stack.callback(session.close)
            return learner

        yield make


@pytest.fixture
def actors(sessions: Callable[..., Session], until: Callable[..., None]) -> Callable[[], Actor]:
    """Makes an actor that knows all of what the learner serves."""

    def make() -> Actor:
        actor = Actor(sessions())

        def reached() -> bool:
            # The hub serves joins last, and declarations arrive in order.
            try:
                return not actor.join("?", run="somewhere-else").accepted
            except SessionError:
                return False

        until(reached)
        return actor

    return make
