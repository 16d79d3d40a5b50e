"""Runs for the tests of this folder: logs as a learner writes them, made without one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from dashboard_runs import write_run

from common.wire.credentials import NO_CREDENTIALS
from services.dashboard.collection import RunCollection


@pytest.fixture
def make_run(tmp_path: Path) -> Callable[..., Path]:
    """Writes a run directory in a folder of runs."""

    def make(folder: str = "one", **options: Any) -> Path:
        return write_run(tmp_path / "runs" / folder, **options)

    return make


@pytest.fixture
def stop() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


@pytest.fixture
def collection(tmp_path: Path, stop: threading.Event) -> Callable[..., RunCollection]:
    """A collection that is not started: its runs are polled by the test."""

    def make(*paths: Path) -> RunCollection:
        return RunCollection(paths or [tmp_path / "runs"], NO_CREDENTIALS, stop)

    return make
