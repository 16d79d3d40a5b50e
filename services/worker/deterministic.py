"""Deterministic episodes of a policy: the mean action, each episode from its own initial state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from common.config.settings import RunSettings
from common.maths.policy import Policy
from common.physics.environments import EnvState, make_environment
from common.wire.motion import Motion
from services.worker.policy_reader import PolicyReader

STARTS = 0xE7A1
"""Folded into the run's seed to draw the initial states."""


@dataclass(frozen=True)
class Episodes:
    """Returns [e] float32 and lengths [e] int32; joint positions [t, q] float32 before each step of the first.

    `motions` are the first episodes whole, as many as `evaluation.trajectories`; `step_s` is simulated seconds a step.
    """

    returns: np.ndarray
    lengths: np.ndarray
    qpos: np.ndarray
    motions: Sequence[Motion] = ()
    step_s: float = 0.0


class _Steps(NamedTuple):
    """[t, n, ...]: the steps of the first n environments, whether or not they belong to their first episodes."""

    qpos: Array
    qvel: Array
    action: Array
    reward: Array


_Played = tuple[Array, Array, _Steps]


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
        self._kept = min(settings.evaluation.trajectories, episodes)
        self._run: Callable[[Policy, EnvState], _Played] = jax.jit(self._scan)

    @property
    def step_s(self) -> float:
        """Simulated seconds per step."""
        return self._environment.step_s

    def compile(self) -> None:
        """Compile the program ahead of the first `play`."""
        self._run = jax.jit(self._scan).lower(self._reader.shapes, self._environment.reset(self._key)).compile()

    def play(self, policy: Policy) -> Episodes:
        """Play the first episode of each environment."""
        returns, lengths, steps = jax.device_get(self._run(policy, self._environment.reset(self._key)))
        motions = [
            Motion(*(array[: lengths[n], n] for array in (steps.qpos, steps.qvel, steps.action, steps.reward)))
            for n in range(self._kept)
        ]
        return Episodes(returns, lengths, steps.qpos[: lengths[0], 0], motions, self.step_s)

    def _scan(self, policy: Policy, state: EnvState) -> _Played:
        kept = max(1, self._kept)

        def one_step(carry: tuple[EnvState, Array, Array], _: None) -> tuple[tuple[EnvState, Array, Array], _Steps]:
            before, returns, lengths = carry
            action = self._reader.mode(policy, before.obs)
            state, transition = self._environment.step(before, action)
            first = (lengths == 0) & (transition.episode_length > 0)
            returns = jnp.where(first, transition.episode_return, returns)
            lengths = jnp.where(first, transition.episode_length, lengths)
            step = _Steps(before.bodies.q[:kept], before.bodies.qd[:kept], action[:kept], transition.reward[:kept])
            return (state, returns, lengths), step

        envs = self._environment.num_envs
        start = (state, jnp.zeros(envs, jnp.float32), jnp.zeros(envs, jnp.int32))
        (_, returns, lengths), steps = jax.lax.scan(one_step, start, length=self._steps)
        return returns, lengths, steps


def play_episodes(
    settings: RunSettings, reader: PolicyReader, policy: Policy, episodes: int, threads: int = 0
) -> Episodes:
    """Play `episodes` deterministic episodes. Compiles anew on every call."""
    return DeterministicEpisodes(settings, reader, episodes, threads).play(policy)


def evaluate(
    settings: RunSettings, reader: PolicyReader, policy: Policy, episodes: int, threads: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Returns [e] and lengths [e] of deterministic episodes, as `play_episodes`."""
    played = play_episodes(settings, reader, policy, episodes, threads)
    return played.returns, played.lengths
