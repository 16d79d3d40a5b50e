"""Rollouts: the policy acting in a batch of environments, as one compiled program.

A rollout is a function of the policy, the state of the environments and (seed, slot, generation, seq) alone. The
state advances only in `keep`, once the learner has accepted the rollout; until then the same rollout can be made again.
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
from services.actor.history import DivergedSteps, StateHistory, StepStates
from services.actor.rollouts import CollectedRollout, Trajectory
from services.worker.policy_reader import PolicyReader

_Collected = tuple[EnvState, CollectedRollout[Array], StepStates[Array]]
"""The environments after a rollout, the rollout, and the states it went through."""

Tree = TypeVar("Tree", EnvState, Moments)

RESET, COLLECT = 0, 1
"""Streams of random numbers, folded into an actor's key."""

RESTART = 1
"""Folded into the key of a step, which draws its actions, for the initial states that it may need."""


@dataclass(frozen=True)
class SlotGeneration:
    """A slot and how often it was assigned before: they seed the slot's environments and exploration noise."""

    slot: int
    generation: int


class Collector:
    """The environments of one slot."""

    def __init__(self, settings: RunSettings, holder: SlotGeneration, reader: PolicyReader, threads: int = 0) -> None:
        """Raises SettingsError or PhysicsError as `make_environment` does."""
        self._settings = settings
        self._reader = reader
        self._environment = make_environment(
            settings.task,
            settings.physics,
            num_envs=settings.envs_per_actor,
            episode_length=settings.episode_length,
            threads=threads,
            randomised=settings.randomisation.ranges(),
        )
        key = jax.random.fold_in(jax.random.key(settings.seed), holder.slot)
        self._key = jax.random.fold_in(key, holder.generation)
        self._collect: Callable[..., _Collected] = jax.jit(self._scan)
        self._history = StateHistory(settings.num_steps)
        self._made: tuple[StepStates[Array], Trajectory[np.ndarray]] | None = None
        self._state: EnvState | None = None
        self._pending: EnvState | None = None
        self.seq = 0

    @property
    def physics(self) -> str:
        """Name of the physics engine."""
        return self._environment.physics

    def compile(self) -> None:
        """Reset the environments and compile the rollout program ahead of the first `collect`."""
        self._state = jax.block_until_ready(self._environment.reset(jax.random.fold_in(self._key, RESET)))
        self._collect = jax.jit(self._scan).lower(self._reader.shapes, self._state, self._key).compile()

    def collect(self, policy: Policy) -> tuple[CollectedRollout[np.ndarray], dict[str, float]]:
        """Make rollout number `seq` under this policy; returns it with the seconds spent in each phase.

        Until `keep` is called, every call starts from the same states.
        """
        began_s, physics_s = time.perf_counter(), self._environment.physics_seconds()
        key = jax.random.fold_in(jax.random.fold_in(self._key, COLLECT), self.seq)
        self._pending, collected, states = self._collect(policy, self._state, key)
        on_host: CollectedRollout[np.ndarray] = jax.device_get(collected)
        self._made = states, on_host.trajectory
        timing = {"collect": time.perf_counter() - began_s}
        if physics_s is not None:
            timing["physics"] = (self._environment.physics_seconds() or 0.0) - physics_s
            timing["collect"] -= timing["physics"]
        return on_host, timing

    def keep(self) -> None:
        """Advance to the end of the last rollout, which the learner has accepted."""
        self._state = self._pending
        self.seq += 1
        if self._made is not None:
            self._history.add(*self._made)

    def diverged(self) -> DivergedSteps | None:
        """The steps before the first divergence in the rollout that was kept last; None where there was none."""
        return self._history.diverged()

    @property
    def step_s(self) -> float:
        """Simulated seconds per step."""
        return self._environment.step_s

    def environments(self) -> dict[str, np.ndarray]:
        """The state from which rollout number `seq` starts, by path. Only after `compile`."""
        return to_arrays(self._state)

    def restore(self, arrays: dict[str, np.ndarray], seq: int) -> None:
        """Continue at `seq` from what `environments` returned there, here or in another process. Only after `compile`.

        Raises:
            CodecError: the arrays are those of another engine or of other settings.
        """
        self._state = jax.device_put(from_arrays(self._state, arrays))
        self._pending = None
        self.seq = seq
        self._history.clear()

    def _scan(self, policy: Policy, state: EnvState, key: Array) -> _Collected:
        """T steps. A run that branches adds one: the last step repeated with the mirrored action."""
        steps = self._settings.num_steps
        keys = jax.random.split(key, steps)
        mirrored = jnp.zeros(steps, jnp.bool_)
        if self._settings.branches:
            keys, mirrored = jnp.concatenate([keys, keys[-1:]]), jnp.arange(steps + 1) == steps
        step = partial(self._one_step, policy)
        start = (state, state, policy.observations, jnp.zeros_like(state.obs))
        (end, _, _, truncated_obs), (trajectory, states) = jax.lax.scan(step, start, (keys, mirrored))
        mirror = jax.tree.map(lambda x: x[-1] if self._settings.branches else x[0, :0], trajectory)
        trajectory = jax.tree.map(lambda x: x[:steps], replace(trajectory, next_obs=trajectory.next_obs[:0]))
        diverged = (end.diverged - state.diverged).sum()
        states = jax.tree.map(lambda x: x[:steps], states)
        return end, CollectedRollout(trajectory, end.obs, truncated_obs, mirror, diverged), states

    def _one_step(
        self, policy: Policy, carry: tuple[EnvState, EnvState, Moments, Array], at_t: tuple[Array, Array]
    ) -> tuple[tuple[EnvState, EnvState, Moments, Array], tuple[Trajectory[Array], StepStates[Array]]]:
        """One step from the newest state or, mirrored, from the state before it; the carry holds both.

        Observations are whitened by moments that already include them.
        """
        (newest, before, moments, truncated_obs), (key, mirrored) = carry, at_t
        # Decided while tracing: a run that does not branch compiles no selections.
        branching = bool(self._settings.branches)
        start = _choose(mirrored, before, newest) if branching else newest
        seen = running.merge(moments, start.obs)
        moments = _choose(mirrored, moments, seen) if branching else seen
        action, log_prob, mirror_image = self._reader.sample(replace(policy, observations=moments), start.obs, key)
        action = jnp.where(mirrored, mirror_image, action) if branching else action
        new = self._settings.initial_states == "new"
        after, transition = self._environment.step(start, action, jax.random.fold_in(key, RESTART) if new else None)
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
        states = StepStates(start.bodies.q, start.bodies.qd, after.diverged > start.diverged)
        # The mirrored step is the last one; the environments continue from the state it did not change.
        after = _choose(mirrored, newest, after) if branching else after
        return (after, start, moments, truncated_obs), (made, states)


def _choose(condition: Array, then: Tree, otherwise: Tree) -> Tree:
    return jax.tree.map(partial(jnp.where, condition), then, otherwise)
