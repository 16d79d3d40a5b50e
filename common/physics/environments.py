"""Tasks as batches of environments that reset themselves.

Observations, rewards and terminations are the task's. This module adds to every step, in this order: actions
are clipped to [-1, 1]; a diverged simulation is terminated; an episode is truncated at its length; an environment whose
episode ended returns to its initial state, or to a new one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from common.errors import PhysicsError, SettingsError
from common.physics.bodies import Engine, Layout, State
from common.physics.engines import MJX, NATIVE, require_synchronous_dispatch, resolve_physics
from common.physics.libraries import mjx
from common.physics.lookup import load_definition
from common.physics.mjx import MjxEngine
from common.physics.models import c_model, load_task
from common.physics.native import NativeEngine
from common.physics.randomisation import Ranges, draw
from common.physics.runners import BraxRunner, Runner, TaskRunner
from common.physics.simulation import ReadingLayout
from common.tasks import EPISODE_LENGTH, TASKS

LARGEST = 1e10
"""Absolute value from which a joint position, velocity or acceleration counts as diverged: MuJoCo's `mjMAXVAL`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EnvState:
    """The complete state of N environments. A pytree of arrays with the batch axis in front."""

    bodies: State
    obs: jax.Array
    """[N, O] float32."""
    first_bodies: State
    """The state to which each environment returns when an episode ends, unless new states are drawn."""
    first_obs: jax.Array
    """[N, O] float32."""
    steps: jax.Array
    """[N] int32, steps of the episode so far."""
    episode_return: jax.Array
    """[N] float32, undiscounted sum of the episode's rewards so far."""
    diverged: jax.Array
    """[N] int32, number of times this environment's simulation diverged since `reset`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Transition:
    """The result of one step of N environments."""

    obs: jax.Array
    """[N, O] float32, after the step; if an episode ended, the first of the next one."""
    reward: jax.Array
    """[N] float32."""
    terminated: jax.Array
    """[N] bool, the task ended the episode or its simulation diverged: the value of the next state is 0."""
    truncated: jax.Array
    """[N] bool, the episode reached its length without terminating: bootstrap from `next_obs`."""
    next_obs: jax.Array
    """[N, O] float32, after the step and before the return to the initial state."""
    episode_return: jax.Array
    """[N] float32, undiscounted return of the episode that ended at this step; 0 if none did."""
    episode_length: jax.Array
    """[N] int32, length of the episode that ended at this step; 0 if none did."""


class BatchedEnvironment:
    """N environments of one task. `reset` and `step` are pure functions for use under `jax.jit` and in `jax.lax.scan`.

    Called from outside a compiled function they are compiled as well, once each.
    """

    def __init__(
        self, runner: Runner, engine: Engine, num_envs: int, episode_length: int, randomised: Ranges | None = None
    ) -> None:
        """`randomised`: ranges of the factors of the model's fields, by name."""
        self._runner = runner
        self._engine = engine
        self._episode_length = episode_length
        self._ranges = randomised or {}
        self.num_envs = num_envs
        self.physics = engine.name
        self.action_size = runner.action_size
        self.step_s = runner.step_s
        self._reset, self._step = jax.jit(self._reset_all), jax.jit(self._step_all)
        self.observation_size = int(jax.eval_shape(self._reset_all, jax.random.key(0)).obs.shape[-1])

    def reset(self, key: jax.Array) -> EnvState:
        """Initial states of N episodes, drawn independently."""
        return self._reset(key)

    def step(
        self, state: EnvState, action: jax.Array, reset_key: jax.Array | None = None
    ) -> tuple[EnvState, Transition]:
        """One step of every environment under `action` [N, A], clipped to [-1, 1].

        With a `reset_key`, environments whose episode ended continue in new initial states drawn with it.
        """
        return self._step(state, action, reset_key)

    def physics_seconds(self) -> float | None:
        """Seconds spent inside the physics engine so far, or None if XLA compiled it into one program with the rest."""
        return self._engine.seconds()

    def _reset_all(self, key: jax.Array) -> EnvState:
        scales = draw(key, self._ranges, self.num_envs)
        bodies, obs = jax.vmap(self._runner.reset)(jax.random.split(key, self.num_envs), scales)
        counts = jnp.zeros(self.num_envs, jnp.int32)
        state = EnvState(
            bodies=bodies,
            obs=obs,
            first_bodies=bodies,
            first_obs=obs,
            steps=counts,
            episode_return=jnp.zeros(self.num_envs, jnp.float32),
            diverged=counts,
        )
        return _strongly_typed(state)

    def _step_all(self, state: EnvState, action: jax.Array, reset_key: jax.Array | None) -> tuple[EnvState, Transition]:
        action = jnp.clip(action, -1.0, 1.0)
        bodies, obs, reward, ended = jax.vmap(self._runner.step)(state.bodies, action)
        diverged = ~jax.vmap(_is_sound)(bodies, obs, reward)
        reward = jnp.where(diverged, 0.0, reward)
        next_obs = jnp.where(diverged[:, None], state.obs, obs)
        steps, episode_return = state.steps + 1, state.episode_return + reward
        terminated = ended | diverged
        truncated = (steps >= self._episode_length) & ~terminated
        over = terminated | truncated
        initial_bodies, initial_obs = self._initial(state, over, reset_key)
        transition = Transition(
            obs=_select(over, initial_obs, next_obs),
            reward=reward,
            terminated=terminated,
            truncated=truncated,
            next_obs=next_obs,
            episode_return=jnp.where(over, episode_return, 0.0),
            episode_length=jnp.where(over, steps, 0),
        )
        state = EnvState(
            bodies=_select(over, initial_bodies, bodies),
            obs=transition.obs,
            first_bodies=state.first_bodies,
            first_obs=state.first_obs,
            steps=jnp.where(over, 0, steps),
            episode_return=jnp.where(over, 0.0, episode_return),
            diverged=state.diverged + diverged,
        )
        return _strongly_typed((state, transition))

    def _initial(self, state: EnvState, over: jax.Array, reset_key: jax.Array | None) -> tuple[State, jax.Array]:
        """The bodies and observations [N, O] in which the episodes after those that are `over` [N] start."""
        first = _strongly_typed((state.first_bodies, state.first_obs))
        if reset_key is None:
            return first

        def new() -> tuple[State, jax.Array]:
            keys = jax.random.split(reset_key, self.num_envs)
            return _strongly_typed(jax.vmap(self._runner.reset)(keys, state.bodies.scales))

        # Drawing costs a forward pass of all environments, and in most steps no episode ends.
        return jax.lax.cond(jnp.any(over), new, lambda: first)


def make_environment(
    task: str,
    physics: str = "auto",
    *,
    num_envs: int,
    episode_length: int = EPISODE_LENGTH,
    threads: int = 0,
    randomised: Ranges | None = None,
) -> BatchedEnvironment:
    """A batch of environments of a task.

    Args:
        task: a name that `common.tasks.find_task` knows.
        physics: "auto", "mjx" or "native"; see `common.physics.engines`.
        num_envs: N.
        episode_length: steps after which an episode is truncated.
        threads: threads of the native engine, including the caller's; 0 is one per core. They do not affect results.
        randomised: ranges of the factors of the model's fields, by name (`RandomisationSettings.ranges`).

    Raises:
        SettingsError: a name is unknown or a number out of range.
        PhysicsError: the engine is not installed, or JAX was started with asynchronous dispatch
            (`require_synchronous_dispatch`).
    """
    engine_name = resolve_physics(physics)
    _check_at_least({"num_envs": num_envs, "episode_length": episode_length}, 1)
    _check_at_least({"threads": threads}, 0)
    if engine_name == NATIVE:
        require_synchronous_dispatch()
    make = _make_brax if task in TASKS else _make_own
    runner, engine = make(task, engine_name, num_envs, threads)
    return BatchedEnvironment(runner, engine, num_envs, episode_length, randomised)


def _make_brax(name: str, engine_name: str, num_envs: int, threads: int) -> tuple[Runner, Engine]:
    environment = load_task(name)
    substeps = environment._n_frames
    engine: Engine
    if engine_name == MJX:
        engine = MjxEngine(environment.sys, substeps)
    else:
        engine = NativeEngine(c_model(environment), substeps, num_envs, threads)
    return BraxRunner(environment, engine), engine


def _make_own(name: str, engine_name: str, num_envs: int, threads: int) -> tuple[Runner, Engine]:
    task = load_definition(name)
    layout: Layout = ReadingLayout(task.model, task.reads)
    engine: Engine
    if engine_name == MJX:
        engine = MjxEngine(_on_device(name, task.model), task.frame_skip, layout)
    else:
        engine = NativeEngine(task.model, task.frame_skip, num_envs, threads, layout)
    return TaskRunner(task, engine), engine


def _on_device(name: str, model: Any) -> Any:
    """The model for MJX. Raises PhysicsError: MJX does not have all that it uses."""
    try:
        return mjx.put_model(model)
    except NotImplementedError as error:
        raise PhysicsError(f"MJX cannot simulate task {name}: {error}; choose physics native") from None


def _check_at_least(given: Mapping[str, int], least: int) -> None:
    for name, value in given.items():
        if value < least:
            raise SettingsError(f"{name} is {value}; it must be at least {least}")


def _is_sound(bodies: State, obs: jax.Array, reward: jax.Array) -> jax.Array:
    """True for a simulation that has not diverged: a bool []."""
    # A comparison with NaN is false, so that NaN counts as diverged.
    moving = jnp.concatenate([bodies.q, bodies.qd, bodies.warmstart])
    return jnp.all(jnp.abs(moving) < LARGEST) & jnp.all(jnp.isfinite(obs)) & jnp.isfinite(reward)


def _select(where: jax.Array, then: Any, otherwise: Any) -> Any:
    """`jnp.where` over the leaves of two trees, by a condition [N] on their first axis."""

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(where.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    return jax.tree.map(choose, then, otherwise)


def _strongly_typed(tree: Any) -> Any:
    """The same arrays without JAX's weak types: a step's result as its input must not cause a second compilation."""
    return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, leaf.dtype), tree)
