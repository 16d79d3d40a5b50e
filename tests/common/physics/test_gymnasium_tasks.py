"""Gymnasium's tasks against Gymnasium's own environments, from the same states and under the same actions."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from common.physics.gymnasium_tasks import GYMNASIUM_CLASSES
from common.physics.lookup import load_definition
from common.physics.simulation import Data
from common.tasks import GYMNASIUM

STEPS = 12


def original(name: str) -> Any:
    """Gymnasium's environment of that name, without its registry and wrappers."""
    module = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", GYMNASIUM_CLASSES[name].__name__).lower()
    module = {"walker2d": "walker2d", "humanoid_standup": "humanoidstandup"}.get(module, module)
    found = importlib.import_module(f"gymnasium.envs.mujoco.{module}_v5")
    return getattr(found, f"{GYMNASIUM_CLASSES[name].__name__}Env")()


def data_in(task: Any, env: Any) -> Data:
    """What a task reads, from Gymnasium's simulation."""
    return Data({name: np.array(getattr(env.data, name), np.float32) for name in ("qpos", "qvel", *task.reads)})


@pytest.fixture(params=GYMNASIUM)
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[Any, Any]]:
    """A task, and Gymnasium's environment."""
    with np.errstate(all="ignore"):
        env = original(request.param)
    yield load_definition(request.param), env
    env.close()


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_observations_rewards_and_ends_are_gymnasiums(pair: tuple[Any, Any]) -> None:
    """For every step of an episode under random actions; the first observation has no contact forces."""
    task, env = pair
    observation, _ = env.reset(seed=3)
    assert env.dt == pytest.approx(task.step_s)
    np.testing.assert_allclose(task.observation(data_in(task, env)), observation, rtol=1e-5, atol=1e-5)
    random = np.random.default_rng(1)
    for _ in range(STEPS):
        before = data_in(task, env)
        action = random.uniform(-1, 1, task.model.nu).astype(np.float32)
        command = np.asarray(task.command(action), np.float64)
        low, high = env.action_space.low, env.action_space.high
        np.testing.assert_allclose(command, low + (action + 1) / 2 * (high - low), rtol=1e-5, atol=1e-6)
        observation, reward, terminated, _, _ = env.step(command)
        after = data_in(task, env)
        np.testing.assert_allclose(task.observation(after), observation, rtol=1e-5, atol=1e-4)
        # A velocity is a difference of positions, which float32 holds to 1e-7 of their size, over the step's seconds.
        assert float(task.reward(before, action, after)) == pytest.approx(reward, rel=1e-4, abs=2e-4)
        assert bool(task.terminated(before, action, after)) == terminated
        assert isinstance(task.observation(after).shape[0], int)
        assert task.observation(after).shape == (GYMNASIUM[task_name(task)].observation_size,)
        if terminated:
            return


def task_name(task: Any) -> str:
    return next(name for name, cls in GYMNASIUM_CLASSES.items() if type(task) is cls)
