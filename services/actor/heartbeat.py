"""Twice a second: what the actor is doing, since when, and how fast."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Literal, Self

from common.errors import SessionError
from common.wire.messages import Heartbeat
from services.worker.link import Link, Membership

PERIOD_S = 0.5

NO_POLICY = -1
"""The version of an actor that has not got a snapshot yet."""

State = Literal["compiling", "waiting", "collecting", "pushing", "evaluating"]


class Heart:
    """Sends heartbeats from a thread of its own while it is entered, at once and whenever the work changes kind."""

    def __init__(
        self, link: Link, member: Membership, keep: Callable[[str, int], None] = lambda state, version: None
    ) -> None:
        """`keep(state, version)` is told with each heartbeat, for this machine's own checks."""
        self._link = link
        self._member = member
        self._keep = keep
        self._lock = threading.Lock()
        self._state: State = "compiling"
        self._since_s = time.monotonic()
        self._env_steps = 0
        self._first_env_steps = 0
        self._first_step_s: float | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self.version = NO_POLICY

    def state(self, state: State) -> None:
        """What the actor does from now on. The end of compiling is told at once: work depends on it."""
        with self._lock:
            ready = self._state == "compiling"
            self._state, self._since_s = state, time.monotonic()
        if ready:
            self._beat()

    def stepped(self, env_steps: int) -> None:
        """Environment steps that the learner took. The speed counts from when the first of them were there."""
        with self._lock:
            if self._first_step_s is None:
                self._first_step_s = time.monotonic()
                self._first_env_steps = env_steps
            self._env_steps += env_steps

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while True:
            try:
                self._beat()
            except SessionError:
                return  # the session is closed: this life is over
            if self._ended.wait(PERIOD_S):
                return

    def _beat(self) -> None:
        now = time.monotonic()
        with self._lock:
            elapsed = 0.0 if self._first_step_s is None else now - self._first_step_s
            beat = Heartbeat(
                run=self._member.run,
                slot=self._member.slot,
                incarnation=self._member.incarnation,
                state=self._state,
                version=max(0, self.version),
                env_steps=self._env_steps,
                steps_per_s=(self._env_steps - self._first_env_steps) / elapsed if elapsed else 0.0,
                state_s=now - self._since_s,
                t_ns=time.time_ns(),
            )
        self._keep(beat.state, self.version)
        self._link.beat(beat)
