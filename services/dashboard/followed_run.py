"""A run that is shown from its directory: its log as it grows, and its learner's report where that can be asked for."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common.errors import LogReadError, SettingsError
from common.files import read_text
from common.log.follower import LogFollower
from common.log.records import LogMessage
from common.runs.directory import SETTINGS
from common.runs.listing import ListedRun, describe_run, read_summary
from common.wire.credentials import Credentials
from common.wire.report import RunReport
from services.dashboard.learner_link import LearnerLink
from services.dashboard.points import number, text, whole
from services.dashboard.run_view import RunView
from services.dashboard.state import Facts, facts_of_settings, state_of_log, state_of_report

TOPICS = ("/spec", "/update", "/episode", "/eval", "/event")

AT_ONCE = 200
"""Messages read before others are shown again."""

READ_S = 0.3
"""Seconds spent on one log before the next run's turn."""

FRESH_S = 5.0
"""Age at which a report no longer says how a run is."""

GROWING_S = 20.0
"""Seconds since the newest record for which a run counts as running, though its learner cannot be asked."""

AGAIN_S = 10.0
"""Seconds after which a log that was found damaged is read again from its start: it may have been repaired."""


class FollowedRun:
    """One run directory. `poll` is called again and again while somebody looks at the run."""

    def __init__(self, path: Path, identity: str, credentials: Credentials, stop: threading.Event) -> None:
        self.path = path
        self.identity = identity
        self.view = RunView(identity)
        self.touched_s = time.monotonic()
        self._credentials = credentials
        self._stop = stop
        self._follower = LogFollower(path, TOPICS)
        self._facts = Facts()
        self._problem = ""
        self._again_s = 0.0
        self._newest_s = 0.0  # Unix time of the newest record
        self._report: tuple[RunReport, float] | None = None
        self._link: LearnerLink | None = None

    def poll(self) -> bool:
        """Read what was added, and show it; returns True where more is there to be read at once."""
        more = self._read()
        listed = describe_run(self.path)
        summary = read_summary(self.path) if listed is not None and listed.state == "finished" else None
        self.view.show(self._state(listed, summary, reading=more))
        if listed is not None and listed.state != "finished" and not self.linked:
            self._link = LearnerLink(self._endpoint, self._credentials, self._on_report, None, self._wanted, self._stop)
            self._link.start()
        return more

    @property
    def linked(self) -> bool:
        """True while a thread asks the run's learner."""
        return self._link is not None and not self._link.ended

    def join(self) -> None:
        """Wait for the end of the thread that asks the learner."""
        if self._link is not None:
            self._link.join()

    # -- the log -------------------------------------------------------------------------------------------

    def _read(self) -> bool:
        now_s = time.monotonic()
        if self._problem and now_s < self._again_s:
            return False
        if self._problem:
            self.view, self._follower, self._problem = RunView(self.identity), LogFollower(self.path, TOPICS), ""
        try:
            while messages := self._follower.read(AT_ONCE):
                for message in messages:
                    self._take(message)
                if time.monotonic() - now_s > READ_S:
                    return True
        except LogReadError as error:
            self._problem, self._again_s = text(str(error), 600), time.monotonic() + AGAIN_S
        return False

    def _take(self, message: LogMessage) -> None:
        record = message.json()
        if not isinstance(record, Mapping):
            return
        self._newest_s = message.t_ns / 1e9
        if message.topic != "/spec":
            self.view.add(message.topic, record, message.t_ns)
            return
        settings = record.get("settings")
        self._facts = facts_of_settings(text(record.get("run"), 80), settings if isinstance(settings, Mapping) else {})
        self.view.begin(message.t_ns)

    # -- the learner ---------------------------------------------------------------------------------------

    def _endpoint(self) -> str:
        try:
            return str(json.loads(read_text(self.path / SETTINGS))["transport"]["endpoint"])
        except (OSError, ValueError, KeyError, TypeError):
            raise SettingsError(f"{self.path}: no address of a learner") from None

    def _wanted(self) -> bool:
        return time.monotonic() - self.touched_s < 60.0 and read_summary(self.path) is None

    def _on_report(self, report: RunReport | None) -> None:
        # Another run may have the port by now.
        known = self._facts.run
        if report is not None and known in ("-", report.run):
            self._report = (report, time.monotonic())

    def fresh_report(self) -> RunReport | None:
        """The learner's newest report; None where it no longer says how the run is."""
        found = self._report
        return found[0] if found is not None and time.monotonic() - found[1] < FRESH_S else None

    # -- shown ---------------------------------------------------------------------------------------------

    def _state(self, listed: ListedRun | None, summary: dict[str, Any] | None, *, reading: bool) -> dict[str, Any]:
        state = state_of_log(self._facts, self.view.latest, self.view.slots)
        report = self.fresh_report()
        growing = time.time() - self._newest_s < GROWING_S
        if summary is not None:
            state |= {"phase": "finished", "summary": _summary(summary)}
        elif report is not None:
            reported = state_of_report(report)
            if reported.get("version", 0) < state["version"]:
                # A learner that resumes counts from the start while it reads the log, which is there already.
                reported |= {"version": None, "env_steps": None}
            state |= {name: value for name, value in reported.items() if value is not None} | {"asked": True}
        elif growing or (listed is not None and listed.state == "running"):
            state |= {"phase": "training" if state["version"] else "starting"}
        else:
            state |= {"phase": "waiting", "notice": self._waiting(listed)}
        if reading:
            state |= {"notice": "reading the log"}
        if self._problem:
            state |= {"problem": self._problem}
        if summary is None:
            state |= {"now_s": round(time.time(), 1)}
        shown = ("run", "task", "learner", "seed", "mode")
        return state | {name: vars(self._facts)[name] for name in shown} | {"settings": dict(self._facts.details)}

    def _waiting(self, listed: ListedRun | None) -> str:
        if listed is None or listed.state == "starting" or self._facts.run == "-":
            return "waiting for the learner: the run has not begun to write yet"
        return f"waiting for the learner: it is not running; continue it with: reskpn train --resume {self.path}"


def _summary(summary: Mapping[str, Any]) -> dict[str, Any]:
    numbers = ("wall_s", "env_steps_per_s", "train_return_mean", "eval_return_mean", "eval_return_std")
    return {
        **{name: number(summary.get(name)) for name in numbers},
        "eval_episodes": whole(summary.get("eval_episodes")),
        "state_digest": text(summary.get("state_digest"), 40),
    }
