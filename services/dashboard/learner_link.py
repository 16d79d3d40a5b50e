"""The connection to a learner: its report once a second and, where they are wanted, its updates as they come."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from typing import Any

from common.errors import CodecError, SettingsError, WireError
from common.wire.credentials import Credentials
from common.wire.keys import ROOT
from common.wire.report import RunReport
from common.wire.session import Session
from common.wire.status_request import ask, connect

CONNECT_S = 2.0
ASK_EVERY_S = 1.0
AGAIN_S = (1.0, 15.0)
"""Seconds from one attempt to reach a learner to the next, at first and after many: each opens a session anew."""

UPDATES = f"{ROOT}/*/metrics"

MAX_UPDATE_BYTES = 1 << 20

OnUpdate = Callable[[str, dict[str, Any]], None]


class LearnerLink:
    """Asks a learner in a thread of its own, for as long as `wanted` says so, and finds it again after it was lost.

    A learner only answers: it keeps nothing for those that watch it, and waits for none of them.

    Args:
        endpoint: the learner's address at this moment; a resumed run may have another. SettingsError: not known now.
        on_report: called with each report, and with None when there is no answer.
        on_update: called with the run and the record of each update; None where they are read from the log.
        wanted: whether to go on; asked every second.
    """

    def __init__(
        self,
        endpoint: Callable[[], str],
        credentials: Credentials,
        on_report: Callable[[RunReport | None], None],
        on_update: OnUpdate | None,
        wanted: Callable[[], bool],
        stop: threading.Event,
    ) -> None:
        self._endpoint = endpoint
        self._credentials = credentials
        self._on_report = on_report
        self._on_update = on_update
        self._wanted = wanted
        self._stop = stop
        self._thread = threading.Thread(target=self._run, name="learner-link", daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def ended(self) -> bool:
        """True once it was no longer wanted."""
        return not self._thread.is_alive()

    def join(self) -> None:
        self._thread.join()

    def _run(self) -> None:
        pause_s = AGAIN_S[0]
        while not self._stop.is_set() and self._wanted():
            try:
                endpoint = self._endpoint()
                with connect(endpoint, CONNECT_S, self._credentials) as session:
                    pause_s = AGAIN_S[0]
                    self._watch(session, endpoint)
            except (WireError, SettingsError):
                self._on_report(None)
                self._stop.wait(pause_s)
                pause_s = min(2.0 * pause_s, AGAIN_S[1])

    def _watch(self, session: Session, endpoint: str) -> None:
        """Report until the learner is lost, which is a SessionError or CodecError, or no longer wanted."""
        if self._on_update is not None:
            session.subscribe(UPDATES, self._take_update)
        while not self._stop.is_set() and self._wanted():
            began_s = time.monotonic()
            self._on_report(ask(session, endpoint, CONNECT_S))
            self._stop.wait(max(0.1, ASK_EVERY_S - (time.monotonic() - began_s)))

    def _take_update(self, key: str, data: bytes) -> None:
        assert self._on_update is not None
        if len(data) > MAX_UPDATE_BYTES:
            raise CodecError("too_large", f"an update of {len(data):,} bytes")
        try:
            record = json.loads(data)
        except (ValueError, RecursionError):
            raise CodecError("bad_value", "an update that is not JSON") from None
        if isinstance(record, dict):
            self._on_update(key.split("/")[2], record)


def first_report(endpoint: str, credentials: Credentials) -> RunReport:
    """The report of a learner that must be there. SessionError or CodecError with the reason where none answers."""
    with connect(endpoint, credentials=credentials) as session:
        return ask(session, endpoint)
