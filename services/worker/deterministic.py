"""Deterministic episodes of a policy: the mean action, each episode from its own initial state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from common.config.settings import RunSettings
from common.maths.policy import Policy
from common.physics.environments import EnvState, make_environment
from services.worker.policy_reader import PolicyReader

STARTS = 0xE7A1
"""Folded into the run's seed to draw the initial states."""


@dataclass(frozen=True)
class Episodes:
    """Returns [e] float32 and lengths [e] int32; joint positions [t, q] float32 before each step of the first."""

    returns: np.ndarray
    lengths: np.ndarray
    qpos: np.ndarray


class DeterministicEpisodes:
    """Plays a fixed number of episodes of any policy of a run, with one program that is compiled once.

    The initial states depend on the run's seed alone, so that all policies of a run are compared on the same ones.
    """

    def __init__(self, settings: RunSettings, reader: PolicyReader, episodes: int, threads: int = 0) -> None:
        """Raises SettingsError or PhysicsError as `make_environment` does."""
        self._environment = make_environment(
            settings.task,
            settings.physics,
            num_envs=episodes,
            episode_length=settings.episode_length,
            threads=threads,
        )
        self._reader = reader
        self._steps = settings.episode_length
        self._key = jax.random.fold_in(jax.random.key(settings.seed), STARTS)
        self._run: Callable[[Policy, EnvState], tuple[Array, Array, Array]] = jax.jit(self._scan)

    @property
    def step_s(self) -> float:
        """Simulated seconds per step."""
        return self._environment.step_s

    def play(self, policy: Policy) -> Episodes:
        """Play the first episode of each environment."""
        played = self._run(policy, self._environment.reset(self._key))
        returns, lengths, qpos = (np.asarray(array) for array in played)
        return Episodes(returns, lengths, qpos[: lengths[0]])

    def _scan(self, policy: Policy, state: EnvState) -> tuple[Array, Array, Array]:
        def one_step(carry: tuple[EnvState, Array, Array], _: None) -> tuple[tuple[EnvState, Array, Array], Array]:
            before, returns, lengths = carry
            state, transition = self._environment.step(before, self._reader.mode(policy, before.obs))
            first = (lengths == 0) & (transition.episode_length > 0)
            returns = jnp.where(first, transition.episode_return, returns)
            lengths = jnp.where(first, transition.episode_length, lengths)
            return (state, returns, lengths), before.bodies.q[0]

        envs = self._environment.num_envs
        start = (state, jnp.zeros(envs, jnp.float32), jnp.zeros(envs, jnp.int32))
        (_, returns, lengths), qpos = jax.lax.scan(one_step, start, length=self._steps)
        return returns, lengths, qpos


def evaluate(
    settings: RunSettings, reader: PolicyReader, policy: Policy, episodes: int, threads: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Returns [e] and lengths [e] of `episodes` deterministic episodes. Compiles anew on every call."""
    played = DeterministicEpisodes(settings, reader, episodes, threads).play(policy)
    return played.returns, played.lengths
