"""Heartbeats: twice a second, an actor's state, the time it has spent in it, and its speed."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Literal, Self

from common.errors import SessionError
from common.wire.messages import Heartbeat
from services.actor.link import ActorLink
from services.worker.joining import Assignment
from services.worker.state_file import WriteState

PERIOD_S = 0.5

NO_POLICY = -1
"""The version in the state file of an actor that holds no policy yet."""

State = Literal["compiling", "waiting", "collecting", "pushing", "evaluating"]


class HeartbeatSender:
    """Sends heartbeats from its own thread while the context is open, the first one immediately."""

    def __init__(
        self, link: ActorLink, assignment: Assignment, write_state: WriteState = lambda state, version: None
    ) -> None:
        """`write_state(state, version)` is called with each heartbeat, for health checks on this machine."""
        self._link = link
        self._assignment = assignment
        self._write_state = write_state
        self._lock = threading.Lock()
        self._state: State = "compiling"
        self._since_s = time.monotonic()
        self._env_steps = 0
        self._first_env_steps = 0
        self._first_step_s: float | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self.version = NO_POLICY

    def set_state(self, state: State) -> None:
        """Set the actor's state. The end of compiling is sent immediately: the learner waits for it to assign work."""
        with self._lock:
            ready = self._state == "compiling"
            self._state, self._since_s = state, time.monotonic()
        if ready:
            self._send()

    def stepped(self, env_steps: int) -> None:
        """Count environment steps that the learner accepted. The speed is measured from the first of them on."""
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
                self._send()
            except SessionError:
                return  # the session is closed, and with it this incarnation ends
            if self._ended.wait(PERIOD_S):
                return

    def _send(self) -> None:
        now = time.monotonic()
        with self._lock:
            elapsed = 0.0 if self._first_step_s is None else now - self._first_step_s
            heartbeat = Heartbeat(
                run=self._assignment.run,
                slot=self._assignment.slot,
                incarnation=self._assignment.incarnation,
                state=self._state,
                version=max(0, self.version),
                env_steps=self._env_steps,
                steps_per_s=(self._env_steps - self._first_env_steps) / elapsed if elapsed else 0.0,
                state_s=now - self._since_s,
                t_ns=time.time_ns(),
            )
        self._write_state(heartbeat.state, self.version)
        self._link.send_heartbeat(heartbeat)
