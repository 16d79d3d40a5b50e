"""Learners and batches that are small enough to compile and check in a test."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from common.config.settings import AlgorithmSettings, RkhsSettings, RunSettings
from common.learners import LEARNERS
from common.maths import trees
from common.maths.networks import Networks, make_networks
from common.maths.rkhs.make import make_representation
from common.maths.state import Batch, LearnerState, initial_state
from common.maths.update import Metrics, Update, make_update

GAMMA = 0.5
STEPS, ENVS, SLOTS, EPOCHS, MINIBATCHES = 3, 32, 2, 4, 2
DRAWN, UPDATES = 16, 50
CAPACITY = DRAWN * UPDATES
"""Sizes of `probe_learner`; it draws 16 transitions for a functional gradient, and has room for 50 such steps."""

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class SmallLearner:
    """A learner's update, compiled at the first call, and the state it starts from."""

    settings: RunSettings
    networks: Networks
    update: Update
    start: LearnerState
    step: Callable[[LearnerState, Batch], tuple[LearnerState, Metrics]]


@functools.cache
def small_learner(
    settings: RunSettings, observation_size: int, action_size: int, capacity: int | None = None
) -> SmallLearner:
    """The learner of the settings, for a task of those sizes; one compilation a session for each."""
    networks, parameters = make_networks(
        observation_size, action_size, settings.algorithm.hidden, settings.seed, LEARNERS[settings.learner]
    )
    update = make_update(settings, networks)
    start = initial_state(
        networks,
        parameters,
        settings.algorithm,
        representation=make_representation(settings, capacity),
        slots=settings.actors,
        envs_per_slot=settings.envs_per_actor,
        seed=settings.seed,
        critic=update.critic.empty(),
    )
    return SmallLearner(settings, networks, update, start, jax.jit(update))


def probe_learner(name: str, capacity: int | None = None) -> SmallLearner:
    """A learner for one observation and one action, shuffling minibatches, without normalisation of anything."""
    algorithm = AlgorithmSettings(
        gamma=GAMMA,
        epochs=EPOCHS,
        minibatches=MINIBATCHES,
        learning_rate=1e-2,
        hidden=(16, 16),
        normalise_observations=False,
        normalise_rewards=False,
    )
    settings = RunSettings(
        learner=name,
        actors=SLOTS,
        num_envs=ENVS,
        num_steps=STEPS,
        total_steps=UPDATES * STEPS * ENVS,
        algorithm=algorithm,
        rkhs=RkhsSettings(bandwidth=0.1, eta=0.1, samples=DRAWN, capacity=CAPACITY),
    )
    return small_learner(settings, 1, 1, capacity)


def random_batch(learner: SmallLearner, seed: int, *, ends: bool = True) -> Batch:
    """Standard normal numbers everywhere; with `ends`, about a third of the steps terminate or are truncated.

    As in real rollouts, a truncation has its own last observation, and an environment is truncated at most once.
    """
    rng = np.random.default_rng(seed)
    settings, networks = learner.settings, learner.networks
    steps, envs, slots = settings.num_steps, settings.num_envs, settings.actors
    truncated = ends & (rng.integers(0, 2 * steps, envs) == np.arange(steps)[:, None])
    terminated = ends & (rng.random((steps, envs)) < 0.2) & ~truncated

    def normal(*shape: int) -> jax.Array:
        return jnp.asarray(rng.standard_normal(shape), jnp.float32)

    cut = normal(envs, networks.observation_size)
    return Batch(
        obs=normal(steps, envs, networks.observation_size),
        action=normal(steps, envs, networks.action_size),
        log_prob=-1.0 - jnp.square(normal(steps, envs)),
        reward=normal(steps, envs),
        terminated=jnp.asarray(terminated),
        truncated=jnp.asarray(truncated),
        last_obs=normal(envs, networks.observation_size),
        truncated_obs=jnp.where(jnp.asarray(truncated.any(axis=0))[:, None], cut, 0.0),
        slot=jnp.arange(slots, dtype=jnp.int32),
        fresh=jnp.arange(slots) % 2 == 1,
        **mirror_image(normal, settings.branches, networks),
    )


def mirror_image(normal: Callable[..., jax.Array], branches: int, networks: Networks) -> Arrays:
    """Standard normal numbers; every third step terminates, every third is truncated. `branches` may be 0."""
    kind = jnp.arange(branches) % 3
    return {
        "mirror_action": normal(branches, networks.action_size),
        "mirror_reward": normal(branches),
        "mirror_terminated": kind == 1,
        "mirror_truncated": kind == 2,
        "mirror_obs": normal(branches, networks.observation_size),
    }


def changed(state: LearnerState, **arrays: np.ndarray | float) -> LearnerState:
    """The state with some arrays replaced, by path with "__" for "/"; numbers fill the array."""
    old = trees.to_arrays(state)
    new = {
        path: np.broadcast_to(np.asarray(value, old[path].dtype), old[path].shape)
        for path, value in ((name.replace("__", "/"), value) for name, value in arrays.items())
    }
    return jax.tree.map(jnp.asarray, trees.from_arrays(state, old | new))


def same_bits(left: Arrays, right: Arrays) -> bool:
    """Whether two states have the same arrays, to the last bit."""
    return left.keys() == right.keys() and all(left[name].tobytes() == right[name].tobytes() for name in left)
