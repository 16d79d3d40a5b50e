"""The last steps of a slot's environments: out of them come the steps before a simulation diverged.

The rollout program hands out the states it steps through, which stay where they were computed. They are looked at
only after a divergence, so that a run without any pays for the memory alone.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic

import jax
import numpy as np
from jax import Array

from common.wire.divergence import STEPS_BEFORE
from common.wire.motion import Motion
from services.actor.rollouts import Numbers, Trajectory


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class StepStates(Generic[Numbers]):
    """The states of N environments before each of T steps, and which of the steps led to none."""

    qpos: Numbers
    """[T, N, q]"""
    qvel: Numbers
    """[T, N, v]"""
    diverged: Numbers
    """[T, N] bool."""


@dataclass(frozen=True, eq=False)
class DivergedSteps:
    """The last steps of environment `env` up to step `step` of a rollout, at which its simulation diverged."""

    env: int
    step: int
    motion: Motion


@dataclass(frozen=True, eq=False)
class _Made:
    """One rollout: its states, and of its steps [T, N] what a record needs."""

    states: StepStates[Array]
    action: np.ndarray
    reward: np.ndarray
    ended: np.ndarray


class StateHistory:
    """The newest rollouts of a slot, as many as have `STEPS_BEFORE` steps before any step of the newest.

    Args:
        steps: T, of a rollout.
    """

    def __init__(self, steps: int) -> None:
        self._made: deque[_Made] = deque(maxlen=1 + -(-STEPS_BEFORE // steps))

    def add(self, states: StepStates[Array], steps: Trajectory[np.ndarray]) -> None:
        """Add a rollout that follows on the last."""
        self._made.append(_Made(states, steps.action, steps.reward, steps.terminated | steps.truncated))

    def clear(self) -> None:
        """Forget all: the environments have been replaced."""
        self._made.clear()

    def diverged(self) -> DivergedSteps | None:
        """The steps up to the first divergence of the newest rollout; None where none of its simulations diverged."""
        flags = np.asarray(self._made[-1].states.diverged) if self._made else np.zeros((0, 0), bool)
        if not flags.any():
            return None
        step, env = (int(index) for index in np.argwhere(flags)[0])
        ended = np.concatenate([made.ended[:, env] for made in self._made])
        last = len(ended) - len(self._made[-1].ended) + step
        # An episode begins after the step that ended the one before it.
        begins = np.flatnonzero(ended[:last])
        first = max(0, last - STEPS_BEFORE, int(begins[-1]) + 1 if len(begins) else 0)
        motion = Motion(
            *(
                np.concatenate([np.asarray(part)[:, env] for part in parts])[first : last + 1]
                for parts in (
                    [made.states.qpos for made in self._made],
                    [made.states.qvel for made in self._made],
                    [made.action for made in self._made],
                    [made.reward for made in self._made],
                )
            )
        )
        return DivergedSteps(env, step, motion)
