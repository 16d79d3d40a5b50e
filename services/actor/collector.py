"""Rollouts: the policy acting in a batch of environments, as one compiled program.

A rollout is a function of the policy, the state of the environments and (seed, slot, generation, seq) alone. The
state moves on only when `keep` says that the learner took the rollout; until then the same one can be made again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from common.config.settings import RunSettings
from common.maths import running
from common.maths.policy import Policy
from common.maths.running import Moments
from common.maths.trees import from_arrays, to_arrays
from common.physics.environments import EnvState, make_environment
from services.worker.policy_reader import PolicyReader

Tree = TypeVar("Tree", EnvState, Moments)

RESET, COLLECT = 0, 1
"""Streams of random numbers, folded into an actor's key."""


@dataclass(frozen=True)
class Place:
    """What a learner gave this actor: its slot, and how often that was given out before."""

    slot: int
    generation: int


@dataclass(frozen=True)
class Experience:
    """The arrays of one rollout, named as in `common.wire.messages.Rollout`, and seconds by phase."""

    arrays: dict[str, np.ndarray]
    timing: dict[str, float]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trajectory:
    """T steps of N environments, on the device. `next_obs` is after the step, of the same episode."""

    obs: Array
    action: Array
    log_prob: Array
    reward: Array
    terminated: Array
    truncated: Array
    next_obs: Array
    episode_return: Array
    episode_length: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Collected:
    """A rollout on the device. `mirror` is one step, of N environments or, where the run does not branch, of none."""

    trajectory: Trajectory
    last_obs: Array
    truncated_obs: Array
    mirror: Trajectory


class Collector:
    """The environments of one slot."""

    def __init__(self, settings: RunSettings, place: Place, reader: PolicyReader, threads: int = 0) -> None:
        """Raises SettingsError or PhysicsError as `make_environment` does."""
        self._settings = settings
        self._reader = reader
        self._environment = make_environment(
            settings.task,
            settings.physics,
            num_envs=settings.envs_per_actor,
            episode_length=settings.episode_length,
            threads=threads,
        )
        key = jax.random.fold_in(jax.random.key(settings.seed), place.slot)
        self._key = jax.random.fold_in(key, place.generation)
        self._collect: Callable[..., tuple[EnvState, Collected]] = jax.jit(self._scan)
        self._state: EnvState | None = None
        self._pending: EnvState | None = None
        self.seq = 0

    @property
    def physics(self) -> str:
        """The engine that steps the environments."""
        return self._environment.physics

    def compile(self) -> None:
        """Reset the environments and compile the rollout, so that the first one does not wait for it."""
        self._state = jax.block_until_ready(self._environment.reset(jax.random.fold_in(self._key, RESET)))
        self._collect = jax.jit(self._scan).lower(self._reader.template, self._state, self._key).compile()

    def collect(self, policy: Policy) -> Experience:
        """The rollout number `seq` under this policy. Called again before `keep`, it starts from the same states."""
        began_s, physics_s = time.perf_counter(), self._environment.physics_seconds()
        key = jax.random.fold_in(jax.random.fold_in(self._key, COLLECT), self.seq)
        self._pending, collected = self._collect(policy, self._state, key)
        arrays = _host_arrays(collected)
        timing = {"collect": time.perf_counter() - began_s}
        if physics_s is not None:
            timing["physics"] = (self._environment.physics_seconds() or 0.0) - physics_s
            timing["collect"] -= timing["physics"]
        return Experience(arrays, timing)

    def keep(self) -> None:
        """The learner has the rollout: go on from where it ended."""
        self._state = self._pending
        self.seq += 1

    def environments(self) -> dict[str, np.ndarray]:
        """The state that the rollout number `seq` starts from, by path. Only after `compile`."""
        return to_arrays(self._state)

    def restore(self, arrays: dict[str, np.ndarray], seq: int) -> None:
        """Go on as the collector whose `environments` these were, at its `seq`. Only after `compile`.

        Raises:
            CodecError: they are of another engine, or of other settings.
        """
        self._state = jax.device_put(from_arrays(self._state, arrays))
        self._pending = None
        self.seq = seq

    def _scan(self, policy: Policy, state: EnvState, key: Array) -> tuple[EnvState, Collected]:
        """T steps, and in a run that branches one more, which is the last one over again with the mirrored action."""
        steps = self._settings.num_steps
        keys = jax.random.split(key, steps)
        mirrored = jnp.zeros(steps, jnp.bool_)
        if self._settings.branches:
            keys, mirrored = jnp.concatenate([keys, keys[-1:]]), jnp.arange(steps + 1) == steps
        step = partial(self._one_step, policy)
        start = (state, state, policy.observations, jnp.zeros_like(state.obs))
        (state, _, _, truncated_obs), trajectory = jax.lax.scan(step, start, (keys, mirrored))
        mirror = jax.tree.map(lambda x: x[-1] if self._settings.branches else x[0, :0], trajectory)
        trajectory = jax.tree.map(lambda x: x[:steps], replace(trajectory, next_obs=trajectory.next_obs[:0]))
        return state, Collected(trajectory, state.obs, truncated_obs, mirror)

    def _one_step(
        self, policy: Policy, carry: tuple[EnvState, EnvState, Moments, Array], at_t: tuple[Array, Array]
    ) -> tuple[tuple[EnvState, EnvState, Moments, Array], Trajectory]:
        """From the newest state and the one before it to the next two. A mirrored step starts from the one before.

        The policy sees observations through moments that have taken them in.
        """
        (newest, before, moments, truncated_obs), (key, mirrored) = carry, at_t
        branching = bool(self._settings.branches)
        start = _choose(mirrored, before, newest) if branching else newest
        seen = running.merge(moments, start.obs)
        moments = _choose(mirrored, moments, seen) if branching else seen
        action, log_prob, mirror_image = self._reader.sample(replace(policy, observations=moments), start.obs, key)
        action = jnp.where(mirrored, mirror_image, action) if branching else action
        after, transition = self._environment.step(start, action)
        cut = transition.truncated & ~mirrored
        truncated_obs = jnp.where(cut[:, None], transition.next_obs, truncated_obs)
        made = Trajectory(
            obs=start.obs,
            action=action,
            log_prob=log_prob,
            reward=transition.reward,
            terminated=transition.terminated,
            truncated=transition.truncated,
            next_obs=transition.next_obs,
            episode_return=transition.episode_return,
            episode_length=transition.episode_length,
        )
        after = _choose(mirrored, newest, after) if branching else after
        return (after, start, moments, truncated_obs), made


def _choose(condition: Array, then: Tree, otherwise: Tree) -> Tree:
    return jax.tree.map(partial(jnp.where, condition), then, otherwise)


def _host_arrays(collected: Collected) -> dict[str, np.ndarray]:
    """The arrays of a rollout message; episodes and cut observations in the order of time, then environment."""
    host = jax.device_get(collected)
    trajectory, mirror = host.trajectory, host.mirror
    over = trajectory.terminated | trajectory.truncated
    _, cut_envs = np.nonzero(trajectory.truncated)
    return {
        "obs": trajectory.obs,
        "action": trajectory.action,
        "log_prob": trajectory.log_prob,
        "reward": trajectory.reward,
        "terminated": trajectory.terminated,
        "truncated": trajectory.truncated,
        "last_obs": host.last_obs,
        "truncated_obs": host.truncated_obs[cut_envs],
        "episode_return": trajectory.episode_return[over],
        "episode_length": trajectory.episode_length[over],
        "mirror_action": mirror.action,
        "mirror_reward": mirror.reward,
        "mirror_terminated": mirror.terminated,
        "mirror_truncated": mirror.truncated,
        "mirror_obs": mirror.next_obs,
    }
