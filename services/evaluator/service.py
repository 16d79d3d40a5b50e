"""The evaluator as a process: it plays a run's newest policies without exploration and sends the results.

It holds no slot and contributes nothing to training. It may start, be killed and restart at any time; a learner never
waits for an evaluator that falls behind.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.config.settings import TransportSettings
from common.errors import SessionError, SettingsError
from common.physics.engines import require_synchronous_dispatch, resolve_physics
from common.physics.pinning import pinned
from common.runtime import enable_compilation_cache, hardware, software_versions
from common.wire.assessment import MAX_EPISODES, MAX_POSITIONS, Assessment
from common.wire.messages import Orders
from common.wire.motion import pack
from common.wire.session import Session
from services.evaluator.link import EvaluatorLink
from services.evaluator.state_refresher import StateRefresher
from services.worker.deterministic import DeterministicEpisodes
from services.worker.joining import Assignment, connect, join
from services.worker.link import AssignmentLost
from services.worker.placement import compute_beside
from services.worker.policy_reader import PolicyReader
from services.worker.state_file import state_writer

ORDERS_S = 0.5
SILENCE_S = 60.0
"""A learner without a word for this long is gone: it repeats its orders twice a second, except during an update."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class EvaluationOptions:
    """Which policies are evaluated, and how.

    Attributes:
        every: evaluate each version that is a multiple of this, or the newest one if the evaluator has fallen behind.
        episodes: number of episodes per evaluation.
        positions: steps of the first episode whose joint positions are logged; 0 for none.
        physics: the engine, or "auto"; the run's own setting takes precedence unless that is "auto".
        threads: threads of the native engine; 0 for one per core.
    """

    every: int = 10
    episodes: int = 16
    positions: int = 200
    physics: str = "auto"
    threads: int = 0

    def __post_init__(self) -> None:
        """Raises SettingsError for a number outside its range."""
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
    options: EvaluationOptions,
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
        run: the run to follow, or "" for any.
        connect_timeout_s: how long to wait for a connection, and then for a learner to answer on it; None for ever.
        rejoin_timeout_s: the same for a lost learner or its successor; None for ever.
        say: called with messages for the user.
        state_file: the file that `python -m reskpn.health evaluator` reads; None for none.

    Raises:
        RefusedError: the learner does not accept this evaluator.
        SessionError: no learner answered within the time.
        SettingsError: the state file cannot be written, or the run's task is one of somebody's own that may not be
            imported here or is another version of it.
    """
    with StateRefresher(state_writer(state_file)) as state:
        state.set("starting")
        enable_compilation_cache()
        require_synchronous_dispatch()
        engine = resolve_physics(options.physics)
        while not stop.is_set():
            with connect(transport, connect_timeout_s, stop) as session:
                assignment = _join(session, run, engine, stop, say, state, connect_timeout_s)
                if assignment is None:
                    return 0
                say(f"following {assignment.run}: {options.episodes} episodes of every {_nth(options.every)} policy")
                pinned(assignment.settings)
                incarnation = EvaluatorIncarnation(session, assignment, transport, options, engine, stop, say, state)
                try:
                    finished = incarnation.work()
                except (AssignmentLost, SessionError) as error:
                    say(f"{error}; joining again")
                    connect_timeout_s = rejoin_timeout_s
                    continue
                if finished:
                    say("the run is over")
                return 0
    return 0


def _join(
    session: Session,
    run: str,
    engine: str,
    stop: threading.Event,
    say: Say,
    state: StateRefresher,
    timeout_s: float | None,
) -> Assignment | None:
    return join(
        session,
        run=run,
        physics=engine,
        versions=software_versions(),
        hardware=hardware(),
        stop=stop,
        waiting=say,
        asked=state.set,
        role="evaluator",
        timeout_s=timeout_s,
    )


class EvaluatorIncarnation:
    """One incarnation of an evaluator, from joining to leaving."""

    def __init__(
        self,
        session: Session,
        assignment: Assignment,
        transport: TransportSettings,
        options: EvaluationOptions,
        engine: str,
        stop: threading.Event,
        say: Say,
        state: StateRefresher,
    ) -> None:
        settings = assignment.settings
        if settings.physics == "auto":
            settings = settings.model_copy(update={"physics": engine})
        compute_beside(settings.physics)
        self._assignment = assignment
        self._options = options
        self._stop = stop
        self._say = say
        self._state = state
        self._link = EvaluatorLink(session, assignment, push_timeout_s=transport.push_timeout_s)
        self._reader = PolicyReader(settings)
        self._episodes = DeterministicEpisodes(settings, self._reader, options.episodes, options.threads)
        self._due = 0

    def work(self) -> bool:
        """Evaluate until the run is over (True) or the evaluator is asked to stop (False).

        Raises:
            AssignmentLost: the learner is gone.
        """
        orders: Orders | None = None
        began_s = time.monotonic()
        self._state.set("waiting")
        while not self._stop.is_set():
            newer = self._link.orders(newer_than=orders, timeout_s=ORDERS_S)
            if newer is None:
                if orders is None and time.monotonic() - began_s > SILENCE_S:
                    raise AssignmentLost("the learner says nothing")
                continue
            orders = newer
            if orders.finished:
                return True
            try:
                if orders.version >= self._due:
                    self._evaluate()
            except AssignmentLost:
                # A learner whose run ended while the episodes were played has left as announced.
                if self._link.over:
                    return True
                raise
        return False

    def _evaluate(self) -> None:
        """Play the newest policy and send the results. Raises AssignmentLost if the learner is gone."""
        snapshot = self._link.snapshot()
        self._state.set("evaluating", snapshot.version)
        began_s = time.monotonic()
        played = self._episodes.play(self._reader.read(snapshot.arrays))
        assessment = Assessment(
            run=self._assignment.run,
            evaluator=self._assignment.incarnation,
            version=snapshot.version,
            episode_return=played.returns,
            episode_length=played.lengths,
            qpos=played.qpos[: min(self._options.positions, MAX_POSITIONS // played.qpos.shape[1])],
            step_s=self._episodes.step_s,
            motions=pack(
                played.motions, run=self._assignment.run, version=snapshot.version, step_s=self._episodes.step_s
            ),
        )
        self._due = (snapshot.version // self._options.every + 1) * self._options.every
        if self._link.push(assessment, self._stop):
            self._say(describe(assessment, time.monotonic() - began_s, self._link.newest))
        self._state.set("waiting")


def describe(assessment: Assessment, took_s: float, newest: int | None) -> str:
    """One line on an assessment: returns, duration, and the number of versions published meanwhile."""
    returns = assessment.episode_return.astype(np.float64)
    behind = max(0, (newest or 0) - assessment.version)
    return (
        f"policy {assessment.version}: return {returns.mean():,.1f} ± {returns.std():,.1f} over {len(returns)} "
        f"episodes in {took_s:.1f} s, " + (f"{behind} versions behind" if behind else "the newest")
    )


def _nth(number: int) -> str:
    return "new" if number == 1 else f"{number}th"
