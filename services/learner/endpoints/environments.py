"""Environment states: those that actors hand in for a checkpoint, and those that a resumed slot goes on from."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection

from common.config.settings import RunSettings
from common.errors import CodecError, LogWriteError
from common.log.writer import LogWriter
from common.physics.state_shapes import state_shapes
from common.wire.keys import Keys
from common.wire.messages import ACCEPTED, Environment, PushReply
from common.wire.session import Request
from services.learner.endpoints.admission import check_holder
from services.learner.endpoints.environment_checks import EnvironmentChecks
from services.learner.endpoints.replies import LOG_FAILED, QUEUE_FULL
from services.learner.scheduling.fleet import Fleet
from services.learner.training.checkpoints import KeptEnvironments


class EnvironmentHandler:
    """Serves `environment/<slot>`: logs and keeps a state that is pushed, and answers a request with the slot's.

    Args:
        changed: the condition that guards `fleet`; nothing here waits under it.
        logged: (version, slot, generation) of the states that a resumed run's log has already.
    """

    def __init__(
        self,
        run: str,
        settings: RunSettings,
        log: LogWriter,
        fleet: Fleet,
        changed: threading.Condition,
        on_refused: Callable[[CodecError], None],
        logged: Collection[tuple[int, int, int]] = (),
    ) -> None:
        keys = Keys(run)
        self._run = run
        self._queue_bytes = settings.transport.queue_bytes
        self._log = log
        self._fleet = fleet
        self._changed = changed
        self._on_refused = on_refused
        self._checks = EnvironmentChecks(
            state_shapes(settings.sizes, settings.envs_per_actor, settings.randomisation.ranges()),
            settings.episode_length,
        )
        self._logged = set(logged)
        self._slots = {keys.environment(slot): slot for slot in range(settings.actors)}
        self._states: dict[int, bytes] = {}
        self._pending: set[int] = set()

    def forget(self) -> None:
        """Drop the states of the version before. To be called under the condition."""
        self._states = {}
        self._pending = set()

    def kept(self) -> KeptEnvironments | None:
        """The states handed in for the version that is collected; None where none were asked for."""
        with self._changed:
            if not self._fleet.hand_in:
                return None
            return KeptEnvironments(self._run, self._fleet.version, self._fleet.given(), dict(self._states))

    def on_request(self, request: Request) -> None:
        """A handler of the session: never waits."""
        if not request.payload:
            request.reply(self._state_of(request.key))
        elif (reply := self._take(request)) is not None:
            request.reply(reply.encode())

    def _state_of(self, key: str) -> bytes:
        # Empty for a slot that starts anew: its actor treats the slot as lost, and joins again.
        with self._changed:
            slot = self._slots.get(key)
            return b"" if slot is None else self._fleet.starts_from(slot) or b""

    def _take(self, request: Request) -> PushReply | None:
        """The answer to a state, or None where the log's thread will give it."""
        try:
            given = Environment.decode(request.payload)
            if self._slots.get(request.key) != given.slot:
                raise CodecError("bad_key", f"environments of slot {given.slot} were pushed on {request.key}")
            if self._log.pending_bytes + len(request.payload) > self._queue_bytes:
                return QUEUE_FULL
            with self._changed:
                wanted = self._admit(given) is None
            if wanted:  # outside of the condition, since it looks at every element
                self._checks.check(given.arrays)
            return self._admit_or_log(given, request)
        except CodecError as error:
            self._on_refused(error)
            return PushReply.of(error)

    def _admit_or_log(self, given: Environment, request: Request) -> PushReply | None:
        with self._changed:
            answer = self._admit(given)
            if answer is None and (given.version, given.slot, given.generation) in self._logged:
                self._states[given.slot] = request.payload
                return ACCEPTED
            if answer is None:
                self._pending.add(given.slot)
        if answer is None:
            try:
                self._log.write("/environment", request.payload, on_durable=lambda: self._keep(given, request))
            except LogWriteError:
                return LOG_FAILED
        return answer

    def _admit(self, given: Environment) -> PushReply | None:
        """None where the state is to be logged and kept. CodecError where it is not wanted."""
        fleet, member = self._fleet, check_holder(self._fleet, self._run, given)
        if given.version != fleet.version or not fleet.hand_in:
            raise CodecError("stale", f"environments of version {given.version} are not wanted now")
        if given.slot in self._states:
            return ACCEPTED
        if given.slot in self._pending:
            return PushReply.busy("being_logged", "these environments are being written to the log")
        if (given.generation, given.seq) != (member.generation, member.next_seq):
            raise CodecError("gap", f"environments at rollout {given.seq} came where {member.next_seq} is next")
        return None

    def _keep(self, given: Environment, request: Request) -> None:
        """On the log's thread: the state is in the file."""
        with self._changed:
            if given.version == self._fleet.version:
                self._states[given.slot] = request.payload
                self._pending.discard(given.slot)
        request.reply(ACCEPTED.encode())
