"""The evaluator's sign of life, in a file: an episode may take longer than such a file counts as new."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Self

from services.worker.state_file import OLD_S, Keep

PERIOD_S = OLD_S / 5


class Pulse:
    """Writes what the evaluator does whenever that changes, and again and again from a thread of its own."""

    def __init__(self, keep: Keep) -> None:
        self._keep = keep
        self._lock = threading.Lock()
        self._state = "starting"
        self._version = -1
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pulse", daemon=True)

    def tell(self, state: str, version: int | None = None) -> None:
        """What is done from now on; with no version, with the policy that it had before."""
        with self._lock:
            self._state = state
            self._version = self._version if version is None else version
            self._keep(self._state, self._version)

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
                self._keep(self._state, self._version)
