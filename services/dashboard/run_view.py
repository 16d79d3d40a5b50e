"""One run as the page shows it: filled by whoever follows the run, read by the streams of pages."""

from __future__ import annotations

import itertools
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from services.dashboard.curves import Curves
from services.dashboard.points import evaluation_point, event_line, update_points, used_rollouts

KEPT_EVENTS = 200
KEPT_EVALUATIONS = 4000
MOST_SLOTS = 1024

_LIVES = itertools.count()


@dataclass
class Cursor:
    """The part of a run that one page has; `epoch` None: nothing yet."""

    epoch: tuple[int, int] | None = None
    rows: int = 0
    evaluations: int = 0
    events: int = 0
    state: Mapping[str, Any] = field(default_factory=dict)


class RunView:
    """Curves, evaluations, events and the present state of one run.

    Args:
        identity: the name by which pages ask for the run.
    """

    def __init__(self, identity: str) -> None:
        self.identity = identity
        self._life = next(_LIVES)
        self._lock = threading.Lock()
        self._curves = Curves()
        self._evaluations: list[dict[str, Any]] = []
        self._events: deque[dict[str, Any]] = deque(maxlen=KEPT_EVENTS)
        self._events_seen = 0
        self._began_ns: int | None = None
        self._episode_return: float | None = None
        self._slots: dict[int, dict[str, Any]] = {}
        self._latest: dict[str, Any] = {}
        self._state: dict[str, Any] = {}

    # -- filled --------------------------------------------------------------------------------------------

    def begin(self, t_ns: int) -> None:
        """Count the hours of the run from this Unix time on, unless they are counted already."""
        with self._lock:
            self._began_ns = self._began_ns or t_ns

    def add(self, topic: str, record: Mapping[str, Any], t_ns: int) -> None:
        """Take in a record of the log, written at that Unix time."""
        with self._lock:
            self._began_ns = self._began_ns or t_ns
            if topic == "/update":
                self._add_update(record, t_ns)
            elif topic == "/episode":
                self._episode_return = record.get("return_mean")
            elif topic == "/eval":
                self._add_evaluation(record, t_ns)
            elif topic == "/event":
                self._events.append(event_line(record, t_ns))
                self._events_seen += 1

    def show(self, state: Mapping[str, Any]) -> None:
        """Replace the present state."""
        with self._lock:
            self._state = dict(state)

    def _add_update(self, record: Mapping[str, Any], t_ns: int) -> None:
        version, env_steps = record.get("version"), record.get("env_steps")
        if not isinstance(version, int) or not isinstance(env_steps, int):
            return
        points = update_points(record)
        if "progress" not in record and self._episode_return is not None:
            points["run/return"] = self._episode_return  # a log of the first release
        self._curves.add(version, {**points, "env_steps": env_steps, "hours": self._hours(t_ns)})
        self._latest = {**self._latest, **points, "version": version, "env_steps": env_steps, "t_s": t_ns / 1e9}
        for slot, used in used_rollouts(record, t_ns).items():
            if slot in self._slots or len(self._slots) < MOST_SLOTS:
                self._slots[slot] = used

    def _hours(self, t_ns: int) -> float:
        return round((t_ns - (self._began_ns or t_ns)) / 3.6e12, 6)

    def _add_evaluation(self, record: Mapping[str, Any], t_ns: int) -> None:
        point = evaluation_point(record)
        if point is None or len(self._evaluations) >= KEPT_EVALUATIONS:
            return
        # Evaluators may come in any order, and a resumed run passes versions a second time.
        known = {(old["version"], old["source"]) for old in self._evaluations[-64:]}
        if (point["version"], point["source"]) not in known:
            self._evaluations.append({**point, "hours": self._hours(t_ns)})

    # -- read ----------------------------------------------------------------------------------------------

    @property
    def latest(self) -> dict[str, Any]:
        """The newest value of each curve, with its version, steps and Unix time."""
        with self._lock:
            return dict(self._latest)

    @property
    def evaluation(self) -> dict[str, Any] | None:
        """The newest evaluation."""
        with self._lock:
            return dict(self._evaluations[-1]) if self._evaluations else None

    @property
    def slots(self) -> dict[int, dict[str, Any]]:
        """The actors whose rollouts were used last, by slot."""
        with self._lock:
            return dict(self._slots)

    @property
    def state(self) -> dict[str, Any]:
        with self._lock:
            return dict(self._state)

    def since(self, cursor: Cursor) -> tuple[dict[str, Any] | None, Cursor]:
        """The rest for a page that has the part at the cursor, None where that is nothing; and the cursor after it."""
        with self._lock:
            epoch = (self._life, self._curves.epoch)
            fresh = cursor.epoch is None or cursor.epoch[0] != self._life
            before = Cursor() if fresh else cursor
            start = before.rows if before.epoch == epoch else 0
            new_events = min(self._events_seen - before.events, len(self._events))
            found: dict[str, Any] = {"fresh": True} if fresh else {}
            if before.epoch != epoch or len(self._curves) > start:
                found |= {"start": start, "width": self._curves.width, "columns": self._curves.since(start)}
            if len(self._evaluations) > before.evaluations:
                found["evaluations"] = self._evaluations[before.evaluations :]
            if new_events:
                found["events"] = list(self._events)[-new_events:]
            if self._state != before.state:
                found["state"] = self._state
            after = Cursor(epoch, len(self._curves), len(self._evaluations), self._events_seen, self._state)
        return ({"id": self.identity, **found} if found else None), after
