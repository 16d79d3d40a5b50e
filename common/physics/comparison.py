"""The two engines beside each other: the same states and actions, and how far their results are apart."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np

from common.physics.engines import MJX, NATIVE, require_synchronous_dispatch
from common.physics.environments import BatchedEnvironment, EnvState, make_environment

ENVIRONMENTS = 4


@dataclass(frozen=True)
class Track:
    """One engine's results from the first states under the actions, by step: qpos, qvel and reward [t, N, ...].

    `steps` [N]: until an episode ended, at which the comparison does.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    reward: np.ndarray
    steps: np.ndarray


@dataclass(frozen=True)
class Apart:
    """The largest differences over environments after a number of steps; `environments` had not ended by then."""

    after: int
    environments: int
    qpos: float
    qvel: float
    reward: float


def compare_engines(task: str, steps: int, seed: int = 0) -> list[Apart]:
    """The differences after 1, 10, 50 and so on up to `steps` steps under random actions. Compiles a step with MJX."""
    require_synchronous_dispatch()
    native, mjx = (make_environment(task, engine, num_envs=ENVIRONMENTS, threads=1) for engine in (NATIVE, MJX))
    first = native.reset(jax.random.key(seed))
    actions = np.random.default_rng(seed).uniform(-1, 1, (steps, ENVIRONMENTS, native.action_size)).astype(np.float32)
    one, other = play(native, first, actions), play(mjx, first, actions)
    both = np.minimum(one.steps, other.steps)
    found = []
    for after in [count for count in (1, 10, 50, 100) if count < steps] + [steps]:
        alive = both >= after
        if alive.any():
            pairs = ((one.qpos, other.qpos), (one.qvel, other.qvel), (one.reward, other.reward))
            apart = (float(np.abs(a[after - 1, alive] - b[after - 1, alive]).max()) for a, b in pairs)
            found.append(Apart(after, int(alive.sum()), *apart))
    return found


def play(environment: BatchedEnvironment, state: EnvState, actions: np.ndarray) -> Track:
    """Play the actions [t, N, A] from a state."""
    qpos, qvel, reward = [], [], []
    ended = np.full(environment.num_envs, len(actions))
    for step, action in enumerate(actions):
        state, transition = environment.step(state, action)
        over = np.asarray(transition.episode_length) > 0
        ended = np.where(over & (ended > step), step, ended)
        qpos.append(np.asarray(state.bodies.q))
        qvel.append(np.asarray(state.bodies.qd))
        reward.append(np.asarray(transition.reward))
    return Track(np.stack(qpos), np.stack(qvel), np.stack(reward), ended)
