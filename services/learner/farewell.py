"""The farewell of a run whose learner died between writing the summary and telling its actors that all is done."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from common.log.reader import LogReader
from common.settings import TransportSettings
from common.wire.door import make_door, refuse_open_doors
from common.wire.keys import JOIN
from common.wire.messages import JoinReply
from common.wire.session import Request
from services.learner.joins import nothing_left
from services.learner.meeting import open_to_actors
from services.learner.resume import repair_log

ASKED_AGAIN_S = 10.0
"""Actors that lost their learner ask every second for another; a connection takes some time to come back."""


def bid_farewell(
    run_dir: Path,
    transport: TransportSettings,
    *,
    stop: threading.Event,
    say: Callable[[str], None],
    wait_s: float = ASKED_AGAIN_S,
) -> None:
    """Answer whoever asks to join that the run in `run_dir` is over, for `wait_s`; then close its log.

    Raises:
        SessionError, SettingsError: as for a learner that begins.
        LogReadError, LogWriteError: the log cannot be closed.
    """
    refuse_open_doors(transport)
    run = LogReader(run_dir).metadata().get("run", {}).get("run", "")

    def answer(request: Request) -> None:
        request.reply(JoinReply(False, nothing_left(run), True, run, 0, 0, "").encode())

    say(f"{run}: its learner did not live to tell its actors that the run is over; telling them, for {wait_s:g} s")
    with make_door(transport), open_to_actors(transport) as session:
        session.serve(JOIN, answer)
        stop.wait(wait_s)
    for note in repair_log(run_dir):
        say(note)
