"""The actor as a process: it joins a learner, collects the rollouts it orders and leaves at the end of the run."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from common.config.settings import TransportSettings
from common.engine_names import MJX
from common.errors import CodecError, PhysicsError, SessionError
from common.maths.policy import Policy
from common.memory import keep_large_blocks
from common.physics.engines import require_synchronous_dispatch, resolve_physics
from common.physics.mjx_differences import differences_of
from common.physics.pinning import pinned
from common.runtime import enable_compilation_cache, hardware, software_versions
from common.wire.divergence import Divergence
from common.wire.messages import Environment, Evaluation, Orders, digest_arrays
from common.wire.motion import pack
from common.wire.rollout import Rollout
from common.wire.session import Session
from services.actor.collector import Collector, SlotGeneration
from services.actor.heartbeat import NO_POLICY, HeartbeatSender
from services.actor.link import ActorLink
from services.actor.rollouts import rollout_message
from services.worker.deterministic import play_episodes
from services.worker.joining import Assignment, connect, join
from services.worker.link import AssignmentLost
from services.worker.placement import compute_beside
from services.worker.policy_reader import PolicyReader
from services.worker.state_file import WriteState, state_writer

ORDERS_S = 0.5


def run_actor(
    transport: TransportSettings,
    *,
    physics: str,
    run: str,
    threads: int,
    connect_timeout_s: float | None,
    rejoin_timeout_s: float | None = None,
    stop: threading.Event,
    say: Callable[[str], None],
    state_file: Path | None = None,
) -> int:
    """Work for the learner at `transport.endpoint` until the run is over or `stop` is set; returns the exit code 0.

    Args:
        physics: the engine, or "auto"; the run's own setting takes precedence unless that is "auto".
        run: the run to work for, or "" for any.
        threads: threads of the native engine, 0 for one per core.
        connect_timeout_s: how long to wait for a connection, and then for a learner to answer on it; None for ever.
        rejoin_timeout_s: the same for a lost learner or its successor; None for ever.
        say: called with messages for the user.
        state_file: the file that `python -m reskpn.health actor` reads; None for none.

    Raises:
        RefusedError: the learner does not accept this actor.
        SessionError: no learner answered within the time.
        SettingsError: the state file cannot be written, or the run's task is one of somebody's own that may not be
            imported here or is another version of it.
    """
    write_state = state_writer(state_file)
    write_state("starting", NO_POLICY)
    enable_compilation_cache()
    keep_large_blocks()
    require_synchronous_dispatch()
    engine = resolve_physics(physics)
    versions, machine = software_versions(), hardware()
    while not stop.is_set():
        # A new session for each incarnation, so that nothing declared for an earlier one remains.
        with connect(transport, connect_timeout_s, stop) as session:
            assignment = join(
                session,
                run=run,
                physics=engine,
                versions=versions,
                hardware=machine,
                stop=stop,
                waiting=say,
                asked=lambda state: write_state(state, NO_POLICY),
                timeout_s=connect_timeout_s,
            )
            if assignment is None:
                return 0
            pinned(assignment.settings)
            begin = partial(ActorIncarnation, session, assignment, transport, engine, threads, stop, write_state)
            if not _work(begin, assignment, engine, say):
                connect_timeout_s = rejoin_timeout_s
                continue
            return 0
    return 0


def _work(
    begin: Callable[[], ActorIncarnation], assignment: Assignment, engine: str, say: Callable[[str], None]
) -> bool:
    """Work as one incarnation to its end. Returns False if the slot or the learner was lost: the actor joins again."""
    physics = engine if assignment.settings.physics == "auto" else assignment.settings.physics
    say(
        f"joined {assignment.run} as slot {assignment.slot} (generation {assignment.generation}) with {physics} physics"
    )
    compute_beside(physics)
    for difference in differences_of(assignment.settings.task) if physics == MJX else ():
        say(f"warning: physics mjx simulates another model: {difference}")
    try:
        finished = begin().work()
    except (AssignmentLost, SessionError) as error:
        say(f"{error}; joining again")
        return False
    if finished:
        say("the run is over")
    return True


class ActorIncarnation:
    """One incarnation of an actor, from joining to leaving."""

    def __init__(
        self,
        session: Session,
        assignment: Assignment,
        transport: TransportSettings,
        engine: str,
        threads: int,
        stop: threading.Event,
        write_state: WriteState,
    ) -> None:
        settings = assignment.settings
        if settings.physics == "auto":
            settings = settings.model_copy(update={"physics": engine})
        self._assignment = assignment
        self._settings = settings
        self._threads = threads
        self._stop = stop
        self._link = ActorLink(session, assignment, push_timeout_s=transport.push_timeout_s)
        self._heartbeats = HeartbeatSender(self._link, assignment, write_state)
        self._policy: Policy | None = None
        self._version = -1
        self._made = 0
        self._evaluated = -1
        self._handed_in = -1
        self._push_s = 0.0

    def work(self) -> bool:
        """Follow the learner's orders until the run is over (True) or the actor is asked to stop (False).

        Raises:
            AssignmentLost: the learner is gone or has given the slot to another actor.
        """
        with self._heartbeats:
            reader = PolicyReader(self._settings)
            holder = SlotGeneration(self._assignment.slot, self._assignment.generation)
            collector = Collector(self._settings, holder, reader, self._threads)
            collector.compile()
            if self._assignment.restore:
                self._restore(collector)
            self._heartbeats.set_state("waiting")
            orders: Orders | None = None
            more = False
            while not self._stop.is_set():
                # With work left, only look whether newer orders have replaced it.
                newer = self._link.orders(newer_than=orders, timeout_s=0.0 if more else ORDERS_S)
                orders = newer or orders
                if orders is None or not (newer or more):
                    continue
                if orders.finished:
                    return True
                more = self._follow(orders, reader, collector)
        return False

    def _follow(self, orders: Orders, reader: PolicyReader, collector: Collector) -> bool:
        """Do the next piece of work for this slot; True if these orders may contain more.

        Raises:
            AssignmentLost: the orders no longer contain the slot.
        """
        slot = self._assignment.slot
        if slot not in orders.collect:
            raise AssignmentLost("the learner has given this actor up")
        wanted = orders.collect[slot] - (self._made if self._version == orders.version else 0)
        evaluate = slot in orders.evaluate and self._evaluated != orders.version
        if wanted <= 0 and not evaluate:
            return False
        if self._version != orders.version:
            snapshot = self._link.snapshot()
            self._policy, self._version, self._made = reader.read(snapshot.arrays), snapshot.version, 0
            self._heartbeats.version = snapshot.version
        if self._policy is None or self._version != orders.version:
            return False  # the learner has published a newer version, whose orders are on their way
        if wanted > 0:
            return (self._hand_in(collector) if orders.hand_in else True) and self._collect(collector, self._policy)
        self._evaluate(reader, self._policy, orders.evaluate[slot])
        return False

    def _restore(self, collector: Collector) -> None:
        """Continue from the environments that the learner keeps for this slot."""
        kept = self._link.environment()
        try:
            collector.restore(kept.arrays, kept.seq)
        except CodecError as error:
            raise PhysicsError(
                f"the environments that slot {self._assignment.slot} goes on from do not fit the {collector.physics} "
                f"engine here ({error}); give the engine that the run began with, by --physics"
            ) from None

    def _hand_in(self, collector: Collector) -> bool:
        """Send the learner the state of the environments; True if it has the state at this version."""
        if self._handed_in == self._version:
            return True
        assignment, arrays = self._assignment, collector.environments()
        environment = Environment(
            run=assignment.run,
            slot=assignment.slot,
            incarnation=assignment.incarnation,
            generation=assignment.generation,
            seq=collector.seq,
            version=self._version,
            digest=digest_arrays(arrays),
            arrays=arrays,
        )
        if self._link.push_environment(environment, self._stop):
            self._handed_in = self._version
        return self._handed_in == self._version

    def _collect(self, collector: Collector, policy: Policy) -> bool:
        """Make one rollout and send it to the learner; True if it was accepted."""
        self._heartbeats.set_state("collecting")
        collected, timing = collector.collect(policy)
        timing = {**timing, "push": self._push_s}
        rollout = rollout_message(collected, self._assignment, seq=collector.seq, version=self._version, timing=timing)
        self._heartbeats.set_state("pushing")
        began_s = time.perf_counter()
        taken = self._link.push(rollout, self._stop)
        self._push_s = time.perf_counter() - began_s
        if taken:
            collector.keep()
            self._made += 1
            if collected.diverged:
                self._report_divergence(collector, rollout)
            self._heartbeats.stepped(self._settings.envs_per_actor * self._settings.num_steps)
        self._heartbeats.set_state("waiting")
        return taken

    def _report_divergence(self, collector: Collector, rollout: Rollout) -> None:
        """Send the steps before the first divergence in the rollout that was accepted last."""
        found = collector.diverged()
        if found is None:
            return
        motion = found.motion
        divergence = Divergence(
            run=rollout.run,
            slot=rollout.slot,
            incarnation=rollout.incarnation,
            generation=rollout.generation,
            seq=rollout.seq,
            policy_version=rollout.policy_version,
            env=found.env,
            step=found.step,
            step_s=collector.step_s,
            qpos=motion.qpos,
            qvel=motion.qvel,
            action=motion.action,
            reward=motion.reward,
        )
        self._link.push_divergence(divergence, self._stop)

    def _evaluate(self, reader: PolicyReader, policy: Policy, episodes: int) -> None:
        """Evaluate the policy without exploration and send the result."""
        self._heartbeats.set_state("evaluating")
        played = play_episodes(self._settings, reader, policy, episodes, self._threads)
        assignment, version = self._assignment, self._version
        evaluation = Evaluation(
            run=assignment.run,
            slot=assignment.slot,
            incarnation=assignment.incarnation,
            version=version,
            episode_return=played.returns,
            episode_length=played.lengths,
            motions=pack(played.motions, run=assignment.run, version=version, step_s=played.step_s),
        )
        if self._link.push_evaluation(evaluation, self._stop):
            self._evaluated = self._version
        self._heartbeats.set_state("waiting")
