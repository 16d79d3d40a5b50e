"""One simulation of a task on an engine: its first state and its steps, whatever family the task is of."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from common.physics.bodies import Engine, Scales
from common.physics.libraries import envs
from common.physics.simulation import AFTER_CONSTRAINTS, Simulation, data_of
from common.physics.task import Task

Stepped = tuple[Any, jax.Array, jax.Array, jax.Array]
"""The state, obs [O], reward [] float32 and termination [] bool after a step."""


class Runner(Protocol):
    """Functions of one simulation, without a batch axis."""

    action_size: int
    step_s: float

    def reset(self, key: jax.Array, scales: Scales) -> tuple[Any, jax.Array]:
        """The first state of an episode, and its observation [O]."""
        ...

    def step(self, state: Any, action: jax.Array) -> Stepped:
        """The result of one step under an action [A] in [-1, 1]."""
        ...


class BraxRunner:
    """A task of `brax.envs`: its observation, reward and termination are brax's own code."""

    def __init__(self, environment: Any, engine: Engine) -> None:
        """`environment`: the brax environment, whose physics is replaced by `engine`."""
        self._environment = environment
        self._engine = engine
        self.action_size = int(environment.action_size)
        self.step_s = float(environment.dt)

    def reset(self, key: jax.Array, scales: Scales) -> tuple[Any, jax.Array]:
        first = self._with_scales(scales).reset(key)
        return first.pipeline_state, first.obs

    def step(self, state: Any, action: jax.Array) -> Stepped:
        zero = jnp.zeros(())
        # The tasks read nothing but the bodies of the state before the step.
        before = envs.State(pipeline_state=state, obs=zero, reward=zero, done=zero, metrics={}, info={})
        after = self._with_scales(state.scales).step(before, action)
        return after.pipeline_state, after.obs, jnp.asarray(after.reward, jnp.float32), after.done > 0

    def _with_scales(self, scales: Scales) -> Any:
        """The environment with this engine; brax's code has no argument for the factors."""
        environment = copy.copy(self._environment)
        environment.pipeline_init = lambda q, qd, act=None, ctrl=None: self._engine.reset(q, qd, scales)
        environment.pipeline_step = self._engine.step
        return environment


class TaskRunner:
    """A `Task`."""

    def __init__(self, task: Task, engine: Engine) -> None:
        self._task = task
        self._engine = engine
        self.action_size = int(task.model.nu)
        self.step_s = task.step_s

    def reset(self, key: jax.Array, scales: Scales) -> tuple[Any, jax.Array]:
        state: Simulation = self._engine.reset(*self._task.first_state(key), scales)
        zeroed = {name: jnp.zeros_like(state.read[name]) for name in AFTER_CONSTRAINTS if name in state.read}
        state = replace(state, read=state.read | zeroed)
        return state, jnp.asarray(self._task.observation(data_of(state)), jnp.float32)

    def step(self, state: Any, action: jax.Array) -> Stepped:
        after: Simulation = self._engine.step(state, self._task.command(action))
        before_data, after_data = data_of(state), data_of(after)
        reward = self._task.reward(before_data, action, after_data)
        terminated = self._task.terminated(before_data, action, after_data)
        return (
            after,
            jnp.asarray(self._task.observation(after_data), jnp.float32),
            jnp.asarray(reward, jnp.float32),
            jnp.asarray(terminated, bool),
        )
