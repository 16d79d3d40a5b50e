"""The actor as a process: joins a learner, collects what is asked, leaves when the run is over."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import jax

from common.config.settings import TransportSettings
from common.errors import CodecError, PhysicsError, SessionError
from common.maths.policy import Policy
from common.memory import keep_large_blocks
from common.physics.engines import resolve_physics
from common.runtime import hardware, prepare_jax, software_versions
from common.wire.messages import Environment, Evaluation, Orders, Rollout, digest_arrays
from common.wire.session import Session
from services.actor.collector import Collector, Place
from services.actor.heartbeat import NO_POLICY, Heart
from services.worker.deterministic import evaluate
from services.worker.link import Link, Lost, Membership, connect, join
from services.worker.policy_reader import PolicyReader
from services.worker.state_file import state_keeper

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
        physics: the engine, or "auto"; the run's own setting wins unless that is "auto".
        run: the run to work for, or "" for whichever the learner has.
        threads: threads of the native engine, 0 for one a core.
        connect_timeout_s: how long to wait for a learner; None for ever.
        rejoin_timeout_s: how long to wait for one that was lost, or for its successor; None for ever.
        say: told what a person may want to know.
        state_file: where `python -m reskpn.health actor` finds what this actor does; None for nowhere.

    Raises:
        RefusedError: the learner will not have this actor.
        SessionError: no learner within the time.
        SettingsError: the state file cannot be written.
    """
    keep = state_keeper(state_file)
    keep("starting", NO_POLICY)
    prepare_jax()
    keep_large_blocks()
    # A callback into the physics engine must not wait for a computation queued behind it.
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    engine = resolve_physics(physics)
    versions, machine = software_versions(), hardware()
    while not stop.is_set():
        # A session of its own for every life: nothing of an earlier one is declared on it.
        with connect(transport, connect_timeout_s, stop) as session:
            member = join(
                session,
                run=run,
                physics=engine,
                versions=versions,
                hardware=machine,
                stop=stop,
                waiting=say,
                asked=lambda state: keep(state, NO_POLICY),
            )
            if member is None:
                return 0
            physics = engine if member.settings.physics == "auto" else member.settings.physics
            say(f"joined {member.run} as slot {member.slot} (generation {member.generation}) with {physics} physics")
            try:
                finished = Life(session, member, transport, engine, threads, stop, keep).live()
            except (Lost, SessionError) as error:
                say(f"{error}; joining again")
                connect_timeout_s = rejoin_timeout_s
                continue
            if finished:
                say("the run is over")
            return 0
    return 0


class Life:
    """One incarnation of an actor, from joining to leaving."""

    def __init__(
        self,
        session: Session,
        member: Membership,
        transport: TransportSettings,
        engine: str,
        threads: int,
        stop: threading.Event,
        keep: Callable[[str, int], None],
    ) -> None:
        settings = member.settings
        if settings.physics == "auto":
            settings = settings.model_copy(update={"physics": engine})
        self._member = member
        self._settings = settings
        self._threads = threads
        self._stop = stop
        self._link = Link(session, member, push_timeout_s=transport.push_timeout_s)
        self._heart = Heart(self._link, member, keep)
        self._policy: Policy | None = None
        self._version = -1
        self._made = 0
        self._evaluated = -1
        self._handed_in = -1
        self._push_s = 0.0

    def live(self) -> bool:
        """Work until the run is over (True) or the actor is asked to stop (False).

        Raises:
            Lost: the learner is gone or has given the slot away.
        """
        with self._heart:
            reader = PolicyReader(self._settings)
            place = Place(self._member.slot, self._member.generation)
            collector = Collector(self._settings, place, reader, self._threads)
            collector.compile()
            if self._member.restore:
                self._restore(collector)
            self._heart.state("waiting")
            orders: Orders | None = None
            more = False
            while not self._stop.is_set():
                newer = self._link.orders(newer_than=orders, timeout_s=0.0 if more else ORDERS_S)
                orders = newer or orders
                if orders is None or not (newer or more):
                    continue
                if orders.finished:
                    return True
                more = self._follow(orders, reader, collector)
        return False

    def _follow(self, orders: Orders, reader: PolicyReader, collector: Collector) -> bool:
        """Do the next thing that is asked of this slot; whether there may be more, unless newer orders have come.

        Lost where the slot is nobody's any more.
        """
        slot = self._member.slot
        if slot not in orders.collect:
            raise Lost("the learner has given this actor up")
        wanted = orders.collect[slot] - (self._made if self._version == orders.version else 0)
        evaluate = slot in orders.evaluate and self._evaluated != orders.version
        if wanted <= 0 and not evaluate:
            return False
        if self._version != orders.version:
            snapshot = self._link.snapshot()
            self._policy, self._version, self._made = reader.read(snapshot.arrays), snapshot.version, 0
            self._heart.version = snapshot.version
        if self._policy is None or self._version != orders.version:
            return False  # the learner has moved on: newer orders are on their way
        if wanted > 0:
            return (self._hand_in(collector) if orders.hand_in else True) and self._collect(collector, self._policy)
        self._evaluate(reader, self._policy, orders.evaluate[slot])
        return False

    def _restore(self, collector: Collector) -> None:
        """Go on from the environments that the learner keeps for this slot."""
        kept = self._link.environment()
        try:
            collector.restore(kept.arrays, kept.seq)
        except CodecError as error:
            raise PhysicsError(
                f"the environments that slot {self._member.slot} goes on from do not fit the {collector.physics} "
                f"engine here ({error}); give the engine that the run began with, by --physics"
            ) from None

    def _hand_in(self, collector: Collector) -> bool:
        """Bring the learner the environments as they are; whether it has those of this version."""
        if self._handed_in == self._version:
            return True
        member, arrays = self._member, collector.environments()
        environment = Environment(
            run=member.run,
            slot=member.slot,
            incarnation=member.incarnation,
            generation=member.generation,
            seq=collector.seq,
            version=self._version,
            digest=digest_arrays(arrays),
            arrays=arrays,
        )
        if self._link.push_environment(environment, self._stop):
            self._handed_in = self._version
        return self._handed_in == self._version

    def _collect(self, collector: Collector, policy: Policy) -> bool:
        """Make one rollout and bring it to the learner; whether it was taken."""
        self._heart.state("collecting")
        experience = collector.collect(policy)
        rollout = Rollout(
            run=self._member.run,
            slot=self._member.slot,
            incarnation=self._member.incarnation,
            seq=collector.seq,
            policy_version=self._version,
            t_ns=time.time_ns(),
            timing={**experience.timing, "push": self._push_s},
            generation=self._member.generation,
            **experience.arrays,
        )
        self._heart.state("pushing")
        began_s = time.perf_counter()
        taken = self._link.push(rollout, self._stop)
        self._push_s = time.perf_counter() - began_s
        if taken:
            collector.keep()
            self._made += 1
            self._heart.stepped(self._settings.envs_per_actor * self._settings.num_steps)
        self._heart.state("waiting")
        return taken

    def _evaluate(self, reader: PolicyReader, policy: Policy, episodes: int) -> None:
        self._heart.state("evaluating")
        returns, lengths = evaluate(self._settings, reader, policy, episodes, self._threads)
        member = self._member
        evaluation = Evaluation(member.run, member.slot, member.incarnation, self._version, returns, lengths)
        if self._link.push_evaluation(evaluation, self._stop):
            self._evaluated = self._version
        self._heart.state("waiting")
