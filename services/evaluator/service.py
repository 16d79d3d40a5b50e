"""The evaluator as a process: plays the newest policies of a run without exploration, and tells the learner.

It takes no slot and feeds no training. It may come, be killed and come back at any time; a learner that it cannot
keep up with does not wait for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from common.config.settings import TransportSettings
from common.errors import SessionError, SettingsError
from common.physics.engines import resolve_physics
from common.runtime import hardware, prepare_jax, software_versions
from common.wire.assessment import MAX_EPISODES, MAX_POSITIONS, Assessment
from common.wire.messages import Orders
from common.wire.session import Session
from services.evaluator.link import EvaluatorLink
from services.evaluator.pulse import Pulse
from services.worker.deterministic import DeterministicEpisodes
from services.worker.link import Lost, Membership, connect, join
from services.worker.policy_reader import PolicyReader
from services.worker.state_file import state_keeper

ORDERS_S = 0.5
UNHEARD_S = 60.0
"""A learner says its orders twice a second, but for the length of an update; one that says none is gone."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class Work:
    """What is evaluated: each policy whose version is a multiple of `every`, or the newest where that is behind.

    Attributes:
        episodes: of each evaluation.
        positions: steps of the first episode whose joint positions are logged; 0 for none.
        physics: the engine, or "auto"; the run's own setting wins unless that is "auto".
        threads: of the native engine, 0 for one a core.
    """

    every: int = 10
    episodes: int = 16
    positions: int = 200
    physics: str = "auto"
    threads: int = 0

    def __post_init__(self) -> None:
        """Raises SettingsError for what is not possible."""
        for name, value, low, high in (
            ("--every", self.every, 1, None),
            ("--episodes", self.episodes, 1, MAX_EPISODES),
            ("--positions", self.positions, 0, None),
            ("--threads", self.threads, 0, None),
        ):
            if value < low or (high is not None and value > high):
                allowed = f"{low} or more" if high is None else f"{low} to {high}"
                raise SettingsError(f"{name} is {value}; allowed: {allowed}")


def run_evaluator(
    transport: TransportSettings,
    work: Work,
    *,
    run: str,
    connect_timeout_s: float | None,
    rejoin_timeout_s: float | None,
    stop: threading.Event,
    say: Say,
    state_file: Path | None = None,
) -> int:
    """Evaluate for the learner at `transport.endpoint` until the run is over or `stop` is set; returns exit code 0.

    Args:
        run: the run to follow, or "" for whichever the learner has.
        connect_timeout_s: how long to wait for a learner; None for ever.
        rejoin_timeout_s: how long to wait for one that was lost, or for its successor; None for ever.
        say: told what a person may want to know.
        state_file: where `python -m reskpn.health evaluator` finds what this evaluator does; None for nowhere.

    Raises:
        RefusedError: the learner will not have this evaluator.
        SessionError: no learner within the time.
        SettingsError: the state file cannot be written.
    """
    with Pulse(state_keeper(state_file)) as pulse:
        pulse.tell("starting")
        prepare_jax()
        # A callback into the physics engine must not wait for a computation queued behind it.
        jax.config.update("jax_cpu_enable_async_dispatch", False)
        engine = resolve_physics(work.physics)
        while not stop.is_set():
            with connect(transport, connect_timeout_s, stop) as session:
                member = _join(session, run, engine, stop, say, pulse)
                if member is None:
                    return 0
                say(f"following {member.run}: {work.episodes} episodes of every {_nth(work.every)} policy")
                try:
                    finished = Life(session, member, transport, work, engine, stop, say, pulse).live()
                except (Lost, SessionError) as error:
                    say(f"{error}; joining again")
                    connect_timeout_s = rejoin_timeout_s
                    continue
                if finished:
                    say("the run is over")
                return 0
    return 0


def _join(session: Session, run: str, engine: str, stop: threading.Event, say: Say, pulse: Pulse) -> Membership | None:
    return join(
        session,
        run=run,
        physics=engine,
        versions=software_versions(),
        hardware=hardware(),
        stop=stop,
        waiting=say,
        asked=pulse.tell,
        role="evaluator",
    )


class Life:
    """One incarnation of an evaluator, from joining to leaving."""

    def __init__(
        self,
        session: Session,
        member: Membership,
        transport: TransportSettings,
        work: Work,
        engine: str,
        stop: threading.Event,
        say: Say,
        pulse: Pulse,
    ) -> None:
        settings = member.settings
        if settings.physics == "auto":
            settings = settings.model_copy(update={"physics": engine})
        self._member = member
        self._work = work
        self._stop = stop
        self._say = say
        self._pulse = pulse
        self._link = EvaluatorLink(session, member, push_timeout_s=transport.push_timeout_s)
        self._reader = PolicyReader(settings)
        self._episodes = DeterministicEpisodes(settings, self._reader, work.episodes, work.threads)
        self._due = 0

    def live(self) -> bool:
        """Work until the run is over (True) or the evaluator is asked to stop (False).

        Raises:
            Lost: the learner is gone.
        """
        orders: Orders | None = None
        heard_s = time.monotonic()
        self._pulse.tell("waiting")
        while not self._stop.is_set():
            newer = self._link.orders(newer_than=orders, timeout_s=ORDERS_S)
            if newer is None:
                if orders is None and time.monotonic() - heard_s > UNHEARD_S:
                    raise Lost("the learner says nothing")
                continue
            orders = newer
            if orders.finished:
                return True
            try:
                if orders.version >= self._due:
                    self._evaluate()
            except Lost:
                if self._link.over:
                    return True
                raise
        return False

    def _evaluate(self) -> None:
        """Play the newest policy and bring what came of it. Lost where the learner is gone."""
        snapshot = self._link.snapshot()
        self._pulse.tell("evaluating", snapshot.version)
        began_s = time.monotonic()
        played = self._episodes.play(self._reader.read(snapshot.arrays))
        assessment = Assessment(
            run=self._member.run,
            evaluator=self._member.incarnation,
            version=snapshot.version,
            episode_return=played.returns,
            episode_length=played.lengths,
            qpos=played.qpos[: min(self._work.positions, MAX_POSITIONS // played.qpos.shape[1])],
            step_s=self._episodes.step_s,
        )
        self._due = (snapshot.version // self._work.every + 1) * self._work.every
        if self._link.push(assessment, self._stop):
            self._say(describe(assessment, time.monotonic() - began_s, self._link.newest))
        self._pulse.tell("waiting")


def describe(assessment: Assessment, took_s: float, newest: int | None) -> str:
    """One line: what came of the episodes, and how many versions were published meanwhile."""
    returns = assessment.episode_return.astype(np.float64)
    behind = max(0, (newest or 0) - assessment.version)
    return (
        f"policy {assessment.version}: return {returns.mean():,.1f} ± {returns.std():,.1f} over {len(returns)} "
        f"episodes in {took_s:.1f} s, " + (f"{behind} versions behind" if behind else "the newest")
    )


def _nth(number: int) -> str:
    return "new" if number == 1 else f"{number}th"
