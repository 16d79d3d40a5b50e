"""Certificates of a run and of strangers, and a learner that lets in those with the right ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from guarded_sides import GuardedLearner, Outside

from common.config.settings import TransportSettings
from common.wire.endpoint import free_port
from reskpn.authority import Authority, make_all


@pytest.fixture(scope="session")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`learner`, `actor`, `viewer`; `other` has a certificate and no role."""
    out = tmp_path_factory.mktemp("certificates")
    make_all(out, ["learner.example"], days=1)
    Authority.load(out).issue("other", 1)
    return out


@pytest.fixture(scope="session")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of another run."""
    out = tmp_path_factory.mktemp("foreign")
    make_all(out, ["learner.example"], days=1)
    return out


@pytest.fixture
def secured(certificates: Path) -> TransportSettings:
    """Of a learner on loopback that wants certificates."""
    return TransportSettings(endpoint=f"tls/127.0.0.1:{free_port()}", certificates=certificates / "learner")


@pytest.fixture
def learners(tmp_path: Path) -> Iterator[Callable[..., GuardedLearner]]:
    """`learners(transport)`; closed after the test."""
    with ExitStack() as stack:

        def make(transport: TransportSettings) -> GuardedLearner:
            return stack.enter_context(GuardedLearner(transport, tmp_path / "log"))

        yield make


@pytest.fixture
def outside() -> Iterator[Callable[..., Outside]]:
    """`outside(endpoint, credentials)`: a session that connects; closed after the test."""
    with ExitStack() as stack:

        def make(endpoint: str, *args: Any, **options: Any) -> Outside:
            return stack.enter_context(Outside(endpoint, *args, **options))

        yield make
