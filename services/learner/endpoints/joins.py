"""Requests to join: actors are given a slot, evaluators are admitted, others get the reason why not."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from common.config.settings import RunSettings
from common.errors import CodecError, RefusedError
from common.printable import printable, quoted, shortened
from common.wire.messages import FINISHED, Join, JoinReply
from common.wire.session import Request
from services.learner.endpoints.admission import check_join
from services.learner.endpoints.evaluators import EvaluatorHandler
from services.learner.endpoints.monitor import RunMonitor
from services.learner.scheduling.fleet import Fleet

ASK_AGAIN_S = 1.0
"""An actor whose request was refused has repeated it by then."""


def nothing_left(run: str) -> str:
    """The text of a refusal after the end of the run."""
    return f"the run is over, nothing is left to do for run {run!r}"


def another_run(run: str, wanted: str) -> str:
    """The text of a refusal of a request to work for the run `wanted`."""
    return f"this learner runs {run!r}, not {quoted(wanted)}"


class JoinHandler:
    """Serves `join`.

    Args:
        changed: the condition that guards `fleet`, `monitor` and `evaluators`; nothing here waits under it.
        on_event: as the hub's.
    """

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        fleet: Fleet,
        monitor: RunMonitor,
        evaluators: EvaluatorHandler,
        changed: threading.Condition,
        on_refused: Callable[[CodecError], None],
        on_event: Callable[[str, str, str], None],
    ) -> None:
        self._run = run
        self._settings = settings
        self._fleet = fleet
        self._monitor = monitor
        self._evaluators = evaluators
        self._changed = changed
        self._on_refused = on_refused
        self._on_event = on_event
        self._refused_s = -ASK_AGAIN_S

    def standing_by(self) -> bool:
        """True if actors without a slot repeat their requests: they have yet to learn that the run is over."""
        with self._changed:
            return time.monotonic() - self._refused_s < ASK_AGAIN_S

    def on_request(self, request: Request) -> None:
        """A handler of the session: never waits."""
        try:
            join = Join.decode(request.payload)
            check_join(join)
            reply = self._join(join)
        except CodecError as error:
            self._on_refused(error)
            reply = self._no("malformed", str(error), final=True)
        except RefusedError as error:
            with self._changed:
                self._refused_s = time.monotonic()
            reply = self._no("no_slot", str(error), final=False)
        request.reply(reply.encode())

    def _join(self, join: Join) -> JoinReply:
        if join.run not in ("", self._run):
            return self._no("run", another_run(self._run, join.run), final=True)
        if join.role == "evaluator":
            return self._join_evaluator(join)
        physics = join.physics if self._settings.physics == "auto" else self._settings.physics
        host = printable(join.hardware.get("host", "?"), 64)
        with self._changed:
            if self._fleet.finished:
                return self._no(FINISHED, nothing_left(self._run), final=True)
            slot = self._fleet.join(join.incarnation, physics, time.monotonic())
            generation, restore = slot.given - 1, slot.start is not None and slot.start.environment is not None
            self._monitor.joined(slot.number, join.incarnation, host, time.monotonic())
        self._on_event(
            "info",
            "actor_joined",
            f"slot {slot.number} (generation {generation}): {physics} on {host}, "
            f"incarnation {printable(shortened(join.incarnation))}",
        )
        settings = self._settings.model_dump_json()
        return JoinReply.granted(self._run, slot.number, generation, settings, restore=restore)

    def _join_evaluator(self, join: Join) -> JoinReply:
        with self._changed:
            if self._fleet.finished:
                return self._no(FINISHED, f"nothing is left to evaluate of {self._run!r}", final=True)
            try:
                self._evaluators.join(join.incarnation)
            except RefusedError as error:
                return self._no("no_place", str(error), final=False)
        return JoinReply.granted(self._run, 0, 0, self._settings.model_dump_json())

    def _no(self, slug: str, text: str, *, final: bool) -> JoinReply:
        with self._changed:
            self._monitor.join_refused(slug)
        return JoinReply.refused(self._run, slug, text, final=final)
