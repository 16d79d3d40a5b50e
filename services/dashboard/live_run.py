"""A run that is shown from what its learner publishes, where its directory is on another machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from common.wire.credentials import Credentials
from common.wire.report import RunReport
from services.dashboard.followed_run import FRESH_S
from services.dashboard.learner_link import LearnerLink
from services.dashboard.points import text
from services.dashboard.run_view import RunView
from services.dashboard.state import state_of_report


class LiveRun:
    """One run of the learner at an address. Its curves begin with the first update after this object was made."""

    def __init__(self, report: RunReport) -> None:
        self.identity = report.run
        self.view = RunView(report.run)
        self.touched_s = time.monotonic()
        self._began_ns = time.time_ns() - round(report.up_s * 1e9)
        self.view.begin(self._began_ns)
        self._report, self._heard_s = report, time.monotonic()
        self._present: dict[int, str] = {}
        self._answers = True
        self._first = report.progress.version if report.progress else 0

    def take(self, report: RunReport) -> None:
        """Show a report; actors that came or went since the one before become events."""
        if not self._answers:
            self._note("info", "the learner answers again")
        self._report, self._heard_s, self._answers = report, time.monotonic(), True
        present = {actor.slot: text(actor.incarnation)[:8] for actor in report.actors}
        for slot in sorted(present.keys() | self._present.keys()):
            now, before = present.get(slot), self._present.get(slot)
            if now is not None and now != before:
                self._note("info", f"slot {slot}: actor {now} is there")
            elif now is None and before is not None:
                self._note("warning", f"slot {slot}: actor {before} is gone")
        self._present = present
        if report.evaluation is not None:
            self.view.add("/eval", report.evaluation.model_dump(), time.time_ns())

    def lost(self) -> None:
        """Record that the learner does not answer."""
        if self._answers:
            self._note("warning", "the learner does not answer")
        self._answers = False

    def update(self, record: dict[str, Any]) -> None:
        """Take in an update as the learner published it."""
        self.view.add("/update", record, time.time_ns())

    def fresh_report(self) -> RunReport | None:
        """The newest report; None where it no longer says how the run is."""
        return self._report if time.monotonic() - self._heard_s < FRESH_S else None

    def poll(self) -> bool:
        """Show the present state; there is nothing to read."""
        report, latest = self._report, self.view.latest
        state = state_of_report(report) | {"run": report.run, "task": report.task, "learner": report.learner}
        state |= {"now_s": round(time.time(), 1), "asked": True}
        if self._first and latest:
            state |= {"since": f"curves begin at update {self._first + 1}, when this page connected to the learner"}
        if self.fresh_report() is None:
            over = report.progress is not None and report.progress.version >= report.progress.updates
            notice = "the run is over: all updates are made and the learner has left" if over else ""
            waiting = f"waiting for the learner at {text(report.endpoint)}: it does not answer"
            state |= {"phase": "finished" if over else "waiting", "notice": notice or waiting, "actors": []}
        self.view.show(state)
        return False

    def _note(self, level: str, told: str) -> None:
        self.view.add("/event", {"level": level, "text": told}, time.time_ns())


class WatchedLearner:
    """The learner at an address, and its runs one after the other: a learner that was restarted may serve another.

    Args:
        report: its first report, so that there is one.
        add: called with each run that is new.
    """

    def __init__(
        self,
        endpoint: str,
        credentials: Credentials,
        report: RunReport,
        add: Callable[[LiveRun], None],
        stop: threading.Event,
    ) -> None:
        self._runs: dict[str, LiveRun] = {}
        self._add = add
        self._run_of(report).take(report)
        self._newest = report.run
        self._link = LearnerLink(lambda: endpoint, credentials, self._on_report, self._on_update, lambda: True, stop)

    def start(self) -> None:
        self._link.start()

    def join(self) -> None:
        """Wait for the end of the thread, once `stop` is set."""
        self._link.join()

    def _on_report(self, report: RunReport | None) -> None:
        if report is None:
            self._runs[self._newest].lost()
            return
        self._newest = report.run
        self._run_of(report).take(report)

    def _on_update(self, run: str, record: dict[str, Any]) -> None:
        # Behind a router there may be other learners.
        if run in self._runs:
            self._runs[run].update(record)

    def _run_of(self, report: RunReport) -> LiveRun:
        if report.run not in self._runs:
            self._runs[report.run] = LiveRun(report)
            self._add(self._runs[report.run])
        return self._runs[report.run]
