"""Problems with known answers, each of which one kind of fault in the learning would spoil.

No physics: observations are made up, actions are the policy's own, rewards are a formula. O = A = 1.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from small_learners import ENVS, GAMMA, SLOTS, STEPS, UPDATES, probe_learner

from common.maths import gaussians, policy
from common.maths.policy import Policy
from common.maths.state import Batch, LearnerState

Observe = Callable[[np.random.Generator], np.ndarray]
Reward = Callable[[np.ndarray, np.ndarray], np.ndarray]

every_learner = pytest.mark.parametrize("name", ["ppo", "dpo", "reskpn"])


@dataclass(frozen=True)
class Probe:
    """A problem.

    observe: the observations of steps 0 to T of all environments, [T + 1, E].
    reward: of an observation and the action taken there.
    last: whether an episode ends with the step taken at an observation.
    """

    observe: Observe
    reward: Reward
    last: Callable[[np.ndarray], np.ndarray] = lambda o: np.full(o.shape, True)


def plus_or_minus_one(rng: np.random.Generator) -> np.ndarray:
    return rng.choice([-1.0, 1.0], (STEPS + 1, ENVS))


def phase_of_three(_rng: np.random.Generator) -> np.ndarray:
    """-1, 0, 1: an environment's place in its episode of three steps; most episodes lie across two rollouts."""
    return (np.arange(STEPS + 1)[:, None] + np.arange(ENVS)) % 3 - 1.0


@functools.cache
def actor(name: str) -> Callable[[Policy, Array, Array], tuple[Array, Array]]:
    """Actions and their log-probabilities from observations [B, 1] and standard normal noise [B, 1]."""
    update = probe_learner(name).update

    @jax.jit
    def act(snapshot: Policy, observation: Array, noise: Array) -> tuple[Array, Array]:
        mean = policy.act(update.networks, update.representation, snapshot, observation, normalise=False)
        action = mean.total + jnp.exp(mean.log_std) * noise
        return action, gaussians.log_prob(mean.total, mean.log_std, action)

    return act


def collect(name: str, state: LearnerState, probe: Probe, rng: np.random.Generator) -> Batch:
    """A batch of the probe under the policy as it stands."""
    seen = probe.observe(rng).astype(np.float32)
    observation = seen[:-1]
    noise = jnp.asarray(rng.standard_normal((STEPS * ENVS, 1)), jnp.float32)
    action, log_prob = actor(name)(state.policy, jnp.asarray(observation.reshape(-1, 1)), noise)
    reward = probe.reward(observation, np.asarray(action).reshape(STEPS, ENVS))
    return Batch(
        obs=jnp.asarray(observation[..., None]),
        action=action.reshape(STEPS, ENVS, 1),
        log_prob=log_prob.reshape(STEPS, ENVS),
        reward=jnp.asarray(reward, jnp.float32),
        terminated=jnp.asarray(probe.last(observation)),
        truncated=jnp.zeros((STEPS, ENVS), jnp.bool_),
        last_obs=jnp.asarray(seen[-1, :, None]),
        truncated_obs=jnp.zeros((ENVS, 1), jnp.float32),
        slot=jnp.arange(SLOTS, dtype=jnp.int32),
        fresh=jnp.zeros(SLOTS, jnp.bool_),
        mirror_action=jnp.zeros((0, 1)),
        mirror_reward=jnp.zeros(0),
        mirror_terminated=jnp.zeros(0, jnp.bool_),
        mirror_truncated=jnp.zeros(0, jnp.bool_),
        mirror_obs=jnp.zeros((0, 1)),
    )


def train(name: str, probe: Probe, updates: int = UPDATES, *, only_h: bool = False) -> LearnerState:
    """The state after learning on the probe; with `only_h` the networks are put back after every update."""
    step, state = probe_learner(name).step, probe_learner(name).start
    rng = np.random.default_rng(0)
    for _ in range(updates):
        new, _ = step(state, collect(name, state, probe, rng))
        state = replace(new, parameters=state.parameters, optimiser=state.optimiser) if only_h else new
    return state


def values(name: str, state: LearnerState, *observations: float) -> np.ndarray:
    """V at the observations."""
    return np.asarray(
        probe_learner(name).networks.value(state.parameters["critic"], jnp.asarray(observations, jnp.float32)[:, None])
    )


def means(name: str, state: LearnerState, *observations: float) -> np.ndarray:
    """The policy's mean action at the observations: what it does without noise."""
    observation = jnp.asarray(observations, jnp.float32)[:, None]
    return np.asarray(actor(name)(state.policy, observation, jnp.zeros_like(observation))[0])[:, 0]


@every_learner
def test_value_of_a_constant_reward(name):
    """Reward 1 in episodes of one step: V = 1. Fails where the critic does not learn or an end is bootstrapped."""
    state = train(name, Probe(plus_or_minus_one, lambda o, _a: np.ones_like(o)), UPDATES // 2)
    np.testing.assert_allclose(values(name, state, -1.0, 1.0), [1.0, 1.0], atol=1e-3)


@every_learner
def test_value_depends_on_the_observation(name):
    """The reward is the observation: V(o) = o. Fails where targets and observations are out of step."""
    state = train(name, Probe(plus_or_minus_one, lambda o, _a: o), UPDATES // 2)
    np.testing.assert_allclose(values(name, state, -1.0, 1.0), [-1.0, 1.0], atol=1e-3)


@every_learner
def test_value_of_a_delayed_reward(name):
    """Reward 1 for the last of three steps: V = gamma^2, gamma, 1. Fails where discounting or bootstrapping does."""
    state = train(name, Probe(phase_of_three, lambda o, _a: np.float32(o == 1.0), lambda o: o == 1.0), UPDATES // 2)
    np.testing.assert_allclose(values(name, state, -1.0, 0.0, 1.0), [GAMMA**2, GAMMA, 1.0], atol=1e-3)


BEST = Probe(plus_or_minus_one, lambda _o, a: -((a - 0.5) ** 2))
"""The best action is 0.5, everywhere."""

BEST_BY_OBSERVATION = Probe(plus_or_minus_one, lambda o, a: -((a - 0.5 * o) ** 2))
"""The best action is half the observation: the mean of all best actions is of no use."""


@every_learner
def test_policy_finds_the_best_action(name):
    """The mean moves to the best action. Fails where the sign or the ratio of the policy's objective is wrong."""
    np.testing.assert_allclose(means(name, train(name, BEST), -1.0, 1.0), [0.5, 0.5], atol=0.15)


@every_learner
def test_policy_finds_the_best_action_for_each_observation(name):
    """The mean follows the observation. Fails where advantages and observations are out of step."""
    np.testing.assert_allclose(means(name, train(name, BEST_BY_OBSERVATION), -1.0, 1.0), [-0.5, 0.5], atol=0.15)


@pytest.mark.parametrize(("probe", "best"), [(BEST, [0.5, 0.5]), (BEST_BY_OBSERVATION, [-0.5, 0.5])])
def test_expansion_alone_finds_the_best_action(probe, best):
    """With the networks held at their start, the functional gradient alone moves the mean to the best action.

    It starts 0.5 away from it, and a few transitions a step make it noisy: within half of that is well on its way.
    """
    start, end = probe_learner("reskpn").start, train("reskpn", probe, only_h=True)
    np.testing.assert_allclose(means("reskpn", start, -1.0, 1.0), [0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(means("reskpn", end, -1.0, 1.0), best, atol=0.25)
