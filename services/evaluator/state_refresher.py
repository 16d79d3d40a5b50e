"""Refreshes the evaluator's state file while it plays: its episodes may outlast the age at which the file is stale."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

from services.worker.state_file import OLD_S, WriteState

PERIOD_S = OLD_S / 5


class StateRefresher:
    """Writes the evaluator's state whenever it changes, and periodically from its own thread."""

    def __init__(self, write: WriteState) -> None:
        self._write = write
        self._lock = threading.Lock()
        self._state = "starting"
        self._version = -1
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="state-refresher", daemon=True)

    def set(self, state: str, version: int | None = None) -> None:
        """Set and write the state, and the version of the policy held unless that is unchanged (None)."""
        with self._lock:
            self._state = state
            self._version = self._version if version is None else version
            self._write(self._state, self._version)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(PERIOD_S):
            with self._lock:
                self._write(self._state, self._version)
