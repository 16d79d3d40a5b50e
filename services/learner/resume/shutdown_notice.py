"""The shutdown notice of a run whose learner was killed between writing the summary and notifying its actors."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from common.config.settings import TransportSettings
from common.errors import CodecError
from common.log.lock import LogLock
from common.log.reader import LogReader
from common.wire.keys import JOIN, Keys
from common.wire.listener import make_listener_monitor, require_authentication
from common.wire.messages import FINISHED, Join, JoinReply, Orders
from common.wire.session import Request
from services.learner.endpoints.joins import another_run, nothing_left
from services.learner.endpoints.listening import open_listener
from services.learner.resume.plan import repair_log

WAIT_S = 10.0
"""Time for actors to connect after their learner was lost; they try several times a second."""

QUIET_S = 2.0
LONGEST_S = 60.0
PERIOD_S = 0.5


def send_shutdown_notice(
    run_dir: Path,
    transport: TransportSettings,
    *,
    stop: threading.Event,
    say: Callable[[str], None],
    wait_s: float = WAIT_S,
    lock: LogLock | None = None,
) -> None:
    """Notify actors that work for the run in `run_dir`, or ask to, that it is over; then close its log.

    This takes `wait_s`, and longer while requests keep arriving, up to `LONGEST_S`. `lock`: of the log, where the
    caller holds it.

    Raises:
        SessionError, SettingsError: as for a learner that begins.
        LogReadError, LogWriteError: the log cannot be closed.
    """
    require_authentication(transport)
    run = LogReader(run_dir).metadata().get("run", {}).get("run", "")
    began_s = asked_s = time.monotonic()

    def answer(request: Request) -> None:
        nonlocal asked_s
        asked_s = time.monotonic()
        request.reply(_answer(run, request.payload).encode())

    say(
        f"{run}: its learner was killed before it notified its actors that the run is over; notifying them for "
        f"{wait_s:g} s"
    )
    with make_listener_monitor(transport), open_listener(transport) as session:
        session.serve(JOIN, answer)
        orders = session.publisher(Keys(run).policy_notify)
        while not stop.wait(PERIOD_S):
            orders.put(Orders(run, 0, "", 0, {}, {}, True, time.time_ns()).encode())
            now_s = time.monotonic()
            if now_s > began_s + LONGEST_S or now_s > max(began_s + wait_s, asked_s + QUIET_S):
                break
    for note in repair_log(run_dir, lock):
        say(note)


def _answer(run: str, payload: bytes) -> JoinReply:
    try:
        join = Join.decode(payload)
    except CodecError as error:
        return JoinReply.refused(run, "malformed", str(error), final=True)
    if join.run not in ("", run):
        return JoinReply.refused(run, "run", another_run(run, join.run), final=True)
    return JoinReply.refused(run, FINISHED, nothing_left(run), final=True)
