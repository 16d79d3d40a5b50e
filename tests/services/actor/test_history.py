"""The steps before a simulation diverged: out of the rollouts of one slot, within one episode."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from common.wire.divergence import STEPS_BEFORE
from services.actor.history import StateHistory, StepStates
from services.actor.rollouts import Trajectory

ENVS = 2


def add(
    history: StateHistory,
    first: int,
    steps: int,
    diverged: tuple[int, int] | None = None,
    ended: tuple[int, int] | None = None,
) -> None:
    """A rollout of steps numbered from `first`, and 1000 higher in environment 1. `diverged`, `ended`: (step, env)."""
    number = np.arange(first, first + steps, dtype=np.float32)[:, None] + 1000 * np.arange(ENVS, dtype=np.float32)
    flags = np.zeros((2, steps, ENVS), bool)
    for flag, place in zip(flags, (diverged, ended), strict=True):
        if place is not None:
            flag[place] = True
    states: Any = StepStates(number[..., None], number[..., None] + 0.25, flags[0])
    none = np.zeros((steps, 0), np.float32)
    made = Trajectory(
        obs=none, action=number[..., None] + 0.5, log_prob=none, reward=number, terminated=flags[0],
        truncated=flags[1], next_obs=none, episode_return=none, episode_length=none,
    )  # fmt: skip
    history.add(states, made)


def steps_of(history: StateHistory) -> list[float]:
    found = history.diverged()
    assert found is not None
    assert (found.motion.qvel - found.motion.qpos == 0.25).all()
    assert (found.motion.action - found.motion.qpos == 0.5).all()
    np.testing.assert_array_equal(found.motion.reward, found.motion.qpos[:, 0])
    return found.motion.reward.tolist()


def test_none_where_none_diverged() -> None:
    """Before the first rollout, and after one that went well."""
    history = StateHistory(5)
    assert history.diverged() is None
    add(history, 0, 5)
    assert history.diverged() is None


def test_fifty_steps_before_over_several_rollouts() -> None:
    """Steps of 20 a rollout: at step 103 of environment 1, those from 53 on; the step itself is the 51st."""
    history = StateHistory(20)
    for first in range(0, 100, 20):
        add(history, first, 20)
    add(history, 100, 20, diverged=(3, 1))
    found = history.diverged()
    assert found is not None
    assert (found.env, found.step) == (1, 3)
    assert steps_of(history) == [1000.0 + step for step in range(53, 104)]
    assert len(steps_of(history)) == STEPS_BEFORE + 1


@pytest.mark.parametrize("steps", [1, 7, 50, 64])
def test_enough_is_kept_for_rollouts_of_any_length(steps: int) -> None:
    """Fifty steps before even the first step of a rollout."""
    history = StateHistory(steps)
    rollouts = 3 + 60 // steps
    for number in range(rollouts):
        add(history, number * steps, steps, diverged=(0, 0) if number == rollouts - 1 else None)
    last = (rollouts - 1) * steps
    assert steps_of(history) == [float(step) for step in range(last - 50, last + 1)]


def test_only_steps_of_its_own_episode() -> None:
    """Environment 0 ended one at step 12, so what diverged at 16 began at 13; the other environment does not matter."""
    history = StateHistory(10)
    add(history, 0, 10, ended=(9, 1))
    add(history, 10, 10, diverged=(6, 0), ended=(2, 0))
    assert steps_of(history) == [13.0, 14.0, 15.0, 16.0]


def test_an_episode_that_diverges_at_once() -> None:
    """One step, and no step of the episode that ended before it."""
    history = StateHistory(10)
    add(history, 0, 10, ended=(9, 0))
    add(history, 10, 10, diverged=(0, 0))
    assert steps_of(history) == [10.0]


def test_other_environments_forget_what_was() -> None:
    """After `clear`, steps of before are not those of these environments."""
    history = StateHistory(10)
    add(history, 0, 10)
    history.clear()
    add(history, 10, 10, diverged=(1, 0))
    assert steps_of(history) == [10.0, 11.0]
