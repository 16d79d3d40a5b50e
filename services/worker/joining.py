"""Connecting to a learner and joining its run, for actors and evaluators."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from common.config.settings import RunSettings, TransportSettings
from common.config.sources import parse_json
from common.errors import CodecError, RefusedError, SessionError
from common.wire.credentials import Credentials
from common.wire.keys import JOIN
from common.wire.messages import RESUMING, Join, JoinReply
from common.wire.session import Session, open_session
from services.worker.state_file import LEARNER_RESUMES

Role = Literal["actor", "evaluator"]

JOIN_TIMEOUT_S = 5.0
RETRY_S = 0.25
INCARNATION_BYTES = 16
"""An incarnation authorises its holder to act for it, so it must not be guessable, even from its displayed prefix."""

EXPLAIN_EVERY = 20
"""Number of unanswered requests after which the connection is diagnosed and the user is told the cause."""


@dataclass(frozen=True)
class Assignment:
    """The run, its settings and, for an actor, the slot that a learner assigned to one incarnation of a worker.

    `restore`: the slot continues from environments that the learner keeps. `slot`, `generation` and `restore` have no
    meaning for an evaluator.
    """

    run: str
    slot: int
    generation: int
    incarnation: str
    settings: RunSettings
    restore: bool = False


def connect(transport: TransportSettings, timeout_s: float | None, stop: threading.Event) -> Session:
    """Open a session with the learner at `transport.endpoint`. The caller closes it.

    Raises:
        SessionError: there was no connection within the time, or `stop` was set first.
        SettingsError: the credentials cannot be used.
    """
    return open_session(
        connect=[transport.endpoint],
        connect_timeout_s=timeout_s,
        max_message_size=transport.max_message_bytes,
        lease_s=transport.lease_s,
        credentials=Credentials.of(transport),
        router=transport.router,
        give_up=stop.is_set,
    )


def join(
    session: Session,
    *,
    run: str,
    physics: str,
    versions: dict[str, str],
    hardware: dict[str, str],
    stop: threading.Event,
    waiting: Callable[[str], None],
    asked: Callable[[str], None] = lambda state: None,
    role: Role = "actor",
    timeout_s: float | None = None,
) -> Assignment | None:
    """Ask to join until the learner accepts; None if `stop` was set first or the run is over.

    Args:
        run: the run to work for, or "" for any.
        waiting: called with the reason for waiting whenever it changes.
        asked: called with "alone", "standing by" or `LEARNER_RESUMES` after every request that was not accepted.
        timeout_s: how long to wait for any answer, from the call or from the last answer on; None for ever.

    Raises:
        SessionError: nothing answered within the time.
        RefusedError: the learner will never accept this worker (another schema or run).
    """
    told, silence = "", _Silence(session, timeout_s)
    patience_s = JOIN_TIMEOUT_S if timeout_s is None else min(JOIN_TIMEOUT_S, timeout_s)
    while not stop.is_set():
        # A new incarnation for each request: the learner may have accepted one whose reply was lost, and would then
        # know two workers by the same name.
        incarnation = secrets.token_hex(INCARNATION_BYTES)
        question = Join(run, role, incarnation, versions, hardware, physics)
        try:
            reply = JoinReply.decode(session.ask(JOIN, question.encode(), patience_s))
        except SessionError:
            state, reason = "alone", silence.reason()
        except CodecError as error:
            raise RefusedError(f"the learner speaks another protocol: {error}") from None
        else:
            if reply.accepted:
                settings = parse_json(reply.settings)
                return Assignment(reply.run, reply.slot, reply.generation, incarnation, settings, reply.restore)
            if reply.finished:
                waiting(reply.text)
                return None
            if reply.final:
                raise RefusedError(f"the learner does not take this {role}: {reply.text}")
            silence.broken()
            state, reason = LEARNER_RESUMES if reply.slug == RESUMING else "standing by", reply.text
        asked(state)
        if reason != told:
            waiting(reason)
            told = reason
        stop.wait(RETRY_S)
    return None


class _Silence:
    """The requests without an answer since the last one that was answered."""

    def __init__(self, session: Session, timeout_s: float | None) -> None:
        self._session = session
        self._timeout_s = timeout_s
        self._since_s = time.monotonic()
        self._requests = 0
        self._reason = "no learner answers yet"

    def broken(self) -> None:
        """Note an answer: the time starts again."""
        self._since_s = time.monotonic()

    def reason(self) -> str:
        """Count a request without an answer; returns the reason for waiting, with a diagnosis after some of them.

        Raises:
            SessionError: the time is over.
        """
        self._requests += 1
        if self._timeout_s is not None and time.monotonic() - self._since_s >= self._timeout_s:
            raise SessionError(f"no learner answered within {self._timeout_s:g} s: {self._session.explain()}") from None
        if self._requests % EXPLAIN_EVERY == 0:
            self._reason = f"no learner answers yet: {self._session.explain()}"
        return self._reason
