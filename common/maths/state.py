"""Everything the learner is between two updates: one frozen tree, kept whole in a checkpoint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jaxtyping import Bool, Float, Int, UInt32

from common.config.settings import AlgorithmSettings
from common.maths import running
from common.maths.critic.kernel_critic import NO_CORRECTION, CriticState
from common.maths.expansion import RepresentationState
from common.maths.networks import Networks, Parameters
from common.maths.policy import Policy
from common.maths.rkhs.representation import Function, Representation
from common.maths.running import Moments


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LearnerState:
    """State of the learner after `version` updates.

    representation_state: v and what else the representation of h keeps; stored as `momentum` (see `trees`).
    critic: the correction g of the critic's network; without arrays in a run that has none.
    discounted: forward-discounted return of every environment of every slot, for the scale of the rewards.
    key: threefry key data; update v draws only from `fold_in(key, v)`.
    """

    parameters: Parameters
    optimiser: optax.OptState
    expansion: Function
    representation_state: RepresentationState
    observations: Moments
    returns: Moments
    discounted: Float[Array, "S N"]
    key: UInt32[Array, "2"]
    version: Int[Array, ""]
    critic: CriticState

    @property
    def policy(self) -> Policy:
        return Policy(self.parameters["policy"], self.expansion, self.observations)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """The K rollouts of an update side by side: E = K * N environments, rollouts in the order of `slot`.

    Arrays have the names that they have in a rollout (`common.wire.messages.Rollout`).

    truncated_obs: where a truncation happened, the observation the episode was cut at; zero elsewhere.
    slot: the slot of each rollout.
    fresh: whether a rollout is the first one of new environments.
    mirror_*: the last step of the rollouts made once more, from the same states, under a' = 2 m(o) - a; mirror_obs
        follows that step, in the same episode. m is E, or 0 in a run that does not branch.
    """

    obs: Float[Array, "T E O"]
    action: Float[Array, "T E A"]
    log_prob: Float[Array, "T E"]
    reward: Float[Array, "T E"]
    terminated: Bool[Array, "T E"]
    truncated: Bool[Array, "T E"]
    last_obs: Float[Array, "E O"]
    truncated_obs: Float[Array, "E O"]
    slot: Int[Array, "K"]
    fresh: Bool[Array, "K"]
    mirror_action: Float[Array, "m A"]
    mirror_reward: Float[Array, "m"]
    mirror_terminated: Bool[Array, "m"]
    mirror_truncated: Bool[Array, "m"]
    mirror_obs: Float[Array, "m O"]


def make_optimiser(algorithm: AlgorithmSettings) -> optax.GradientTransformation:
    """Adam behind a clip of the global gradient norm (paper, Table 1)."""
    return optax.chain(
        optax.clip_by_global_norm(algorithm.max_grad_norm),
        optax.adam(algorithm.learning_rate, eps=algorithm.adam_eps),
    )


def initial_state(
    networks: Networks,
    parameters: Parameters,
    algorithm: AlgorithmSettings,
    *,
    representation: Representation[Any, Any],
    slots: int,
    envs_per_slot: int,
    seed: int,
    critic: CriticState = NO_CORRECTION,
) -> LearnerState:
    """The state before the first update: h = 0, nothing observed."""
    expansion, representation_state = representation.empty(networks.feature_size, networks.action_size)
    return LearnerState(
        parameters=parameters,
        optimiser=make_optimiser(algorithm).init(parameters),
        expansion=expansion,
        representation_state=representation_state,
        observations=running.start((networks.observation_size,)),
        returns=running.start(()),
        discounted=jnp.zeros((slots, envs_per_slot), jnp.float32),
        key=jax.random.key_data(jax.random.fold_in(jax.random.key(seed), 0x5EED)),
        version=jnp.zeros((), jnp.int32),
        critic=critic,
    )
