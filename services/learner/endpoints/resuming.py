"""The answers of a learner that resumes a run and cannot take actors yet: how far it is."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from common.config.settings import RunSettings
from common.wire.keys import JOIN, STATUS
from common.wire.messages import RESUMING, JoinReply
from common.wire.report import Progress, RunReport, Totals
from common.wire.session import Request, Session


class ResumingEndpoints:
    """Serves `status` and `join` from construction until the hub serves them in its place.

    Args:
        run: id of the run; "" where its log does not say.
    """

    def __init__(self, run: str, settings: RunSettings, session: Session) -> None:
        self.run = run
        self._settings = settings
        self._began_s = time.monotonic()
        self._text = "repairing the log"
        self._handlers: dict[str, Callable[[Request], None]] = {STATUS: self._on_status, JOIN: self._on_join}
        for key in self._handlers:
            session.serve(key, partial(self._on_request, key))

    @property
    def text(self) -> str:
        """The state of the learner as a part of a sentence."""
        return f"resuming, {self._text}"

    def read(self, done: int, total: int) -> None:
        """Note the bytes of the log that were read, of those to be read."""
        self._text = f"{done / 1e6:,.0f} of {total / 1e6:,.0f} MB of the log read"

    def restoring(self) -> None:
        """Note that what was needed of the log is read."""
        self._text = "the log is read, the state is being restored"

    def hand_over(self, key: str, handler: Callable[[Request], None]) -> None:
        """Have `handler` serve `status` or `join` from now on: no request is missed in between."""
        self._handlers[key] = handler

    def _on_request(self, key: str, request: Request) -> None:
        self._handlers[key](request)

    def _on_join(self, request: Request) -> None:
        text = f"the learner is {self.text}; ask again later"
        request.reply(JoinReply.refused(self.run, RESUMING, text, final=False).encode())

    def _on_status(self, request: Request) -> None:
        request.reply(self.report().encode())

    def report(self) -> RunReport:
        """The state of the run at this moment."""
        settings = self._settings
        return RunReport(
            run=self.run,
            task=settings.task,
            learner=settings.learner,
            endpoint=settings.transport.endpoint,
            t_ns=time.time_ns(),
            up_s=time.monotonic() - self._began_s,
            progress=Progress(
                phase="resuming",
                text=self.text,
                version=0,
                updates=settings.updates,
                env_steps=0,
                total_steps=settings.updates * settings.batch_size,
                steps_per_s=None,
                train_return=None,
                staleness=0.0,
                capacity=settings.capacity,
                slots=settings.actors,
            ),
            waiting_for=self.text,
            rollouts_there=0,
            slots=settings.actors,
            actors=[],
            vacancies=[],
            totals=Totals(),
            refusals={},
            refused_joins={},
            last_refusal=None,
        )
