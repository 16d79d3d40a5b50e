"""The player as a process: opens a session, plays the log at a chosen pace, and ends with it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

from common.log.reader import LogMessage
from common.runs.read_ahead import read_ahead
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import RecordedUpdate
from common.wire.access import Names, player_access_control
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.rollout import Rollout
from common.wire.session import open_session
from services.replay.player import Player

LONGEST_PAUSE_S = 5.0
"""Pauses in the log are not kept for longer than this: compilation, or the time until a run was resumed."""

Recorded = tuple[LogMessage, RecordedUpdate | Rollout | None]


def run_player(
    run: RecordedRun,
    endpoint: str,
    *,
    credentials: Credentials = NO_CREDENTIALS,
    rate: float | None,
    delay_s: float,
    stop: threading.Event,
    on_update: Callable[[RecordedUpdate], None],
) -> bool:
    """Play a log to its end, or until `stop` is set; returns True at the end.

    Args:
        endpoint: where subscribers connect.
        credentials: of those allowed to: the run's actors and viewers, by their names.
        rate: speed as a multiple of the run's; None for as fast as subscribers take it.
        delay_s: time for subscribers to connect before the first message.

    Raises:
        SessionError: the endpoint cannot be listened on.
        LogReadError: the log is damaged.
    """
    size = run.settings.transport.max_message_bytes
    access = {}
    if credentials.authenticate(endpoint):
        names = Names(run.settings.transport.actor_names, run.settings.transport.viewer_names)
        access = player_access_control(names, by_password=credentials.users is not None)
    line = open_session(listen=[endpoint], max_message_size=size, credentials=credentials, options=access)
    with line as session, read_ahead(run.messages()) as messages:
        player = Player(run, session)
        if stop.wait(delay_s):
            return False
        paced = messages if rate is None else at_pace(messages, rate, stop)
        for message, content in paced:
            if stop.is_set():
                return False
            player.play(message, content)
            if isinstance(content, RecordedUpdate):
                on_update(content)
        player.finish()
        return not stop.is_set()


def at_pace(
    messages: Iterator[Recorded],
    rate: float,
    stop: threading.Event,
    clock_s: Callable[[], float] = time.monotonic,
) -> Iterator[Recorded]:
    """The messages when they are due: with the pauses of the log, divided by `rate`; ends when `stop` is set."""
    due_s = clock_s()
    last_ns: int | None = None
    for message, content in messages:
        if last_ns is not None:
            pause_s = max(0.0, (message.t_ns - last_ns) / 1e9)
            due_s += min(pause_s, LONGEST_PAUSE_S) / rate
        last_ns = message.t_ns
        if stop.wait(max(0.0, due_s - clock_s())):
            return
        yield message, content
