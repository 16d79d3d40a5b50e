"""An exported policy against the trained one on observations of its run's log, and the time that an action takes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np

from common.errors import LogReadError, NumericsError
from common.log.reader import LogReader
from common.log.segments import find_segments
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import LIMITS
from common.wire.rollout import Rollout
from reskpn.policy_file import Policy

TOLERANCE = 1e-5
"""The largest difference of an action that is allowed, actions being in [-1, 1]."""

OBSERVATIONS = 4096
ROLLOUTS = 4
TIMED = 1000


@dataclass(frozen=True)
class Verified:
    """The largest difference over so many observations, and the median latency of one action."""

    difference: float
    observations: int
    latency_s: float


def verify(policy: Policy, trained: Callable[[jax.Array], jax.Array], observations: np.ndarray) -> Verified:
    """Compare the actions of a file with those of the trained policy.

    Raises:
        NumericsError: they differ by more than `TOLERANCE`.
    """
    wanted = np.asarray(jax.jit(trained)(observations))
    given = policy.act(observations)
    difference = float(np.max(np.abs(given - wanted))) if given.shape == wanted.shape else float("inf")
    if not difference <= TOLERANCE:
        raise NumericsError(
            f"the exported policy differs from the trained one by {difference:.1e} on logged observations, more than "
            f"{TOLERANCE:g}; no file is left. Please report it, with the versions that `reskpn doctor` prints"
        )
    return Verified(difference, len(observations), latency(policy, observations))


def latency(policy: Policy, observations: np.ndarray, clock_s: Callable[[], float] = time.perf_counter) -> float:
    """The median of the seconds that `act` takes for one observation."""
    seconds = []
    for number in range(TIMED):
        observation = observations[number % len(observations)]
        began_s = clock_s()
        policy.act(observation)
        seconds.append(clock_s() - began_s)
    return float(np.median(seconds))


def logged_observations(recorded: RecordedRun) -> np.ndarray:
    """Up to `OBSERVATIONS` raw observations [n, O] of the newest rollouts in the log, evenly spread over them.

    Raises:
        LogReadError: the log is damaged, or holds no rollout yet.
    """
    for segment in reversed(find_segments(recorded.path)):
        newest = deque(LogReader(segment).messages(["/rollout"]), maxlen=ROLLOUTS)
        if newest:
            rollouts = [Rollout.decode(message.data, LIMITS) for message in newest]
            observations = np.concatenate([rollout.obs.reshape(-1, rollout.obs.shape[-1]) for rollout in rollouts])
            rows = np.linspace(0, len(observations) - 1, min(OBSERVATIONS, len(observations))).astype(int)
            return np.asarray(observations[rows], np.float32)
    raise LogReadError(
        f"the log of {recorded.run} has no rollout yet, and an exported policy is verified on logged observations; "
        "export it when the run has made an update"
    )
