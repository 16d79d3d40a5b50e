"""The networks: features psi, residual layer mu, log_std and the critic V (paper, section 3 and Table 1)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jax import Array
from jaxtyping import Float

Parameters = dict
"""A nested dict of arrays: what `nnx.to_pure_dict` makes of a module."""


def _dense(inputs: int, outputs: int, scale: float, rngs: nnx.Rngs) -> nnx.Linear:
    return nnx.Linear(
        inputs,
        outputs,
        kernel_init=nnx.initializers.orthogonal(scale),
        bias_init=nnx.initializers.zeros,
        rngs=rngs,
    )


class Tower(nnx.Module):
    """Dense layers with tanh, orthogonally initialised: R^inputs -> R^widths[-1]."""

    def __init__(self, inputs: int, widths: Sequence[int], rngs: nnx.Rngs) -> None:
        sizes = [inputs, *widths]
        self.layers = nnx.List(_dense(a, b, float(np.sqrt(2)), rngs) for a, b in itertools.pairwise(sizes))

    def __call__(self, x: Float[Array, "B inputs"]) -> Float[Array, "B d"]:
        for layer in self.layers:
            x = jnp.tanh(layer(x))
        return x


class PolicyNetwork(nnx.Module):
    """What of the policy is trained by gradients: psi, mu and log_std."""

    def __init__(self, observation_size: int, action_size: int, hidden: Sequence[int], rngs: nnx.Rngs) -> None:
        self.features = Tower(observation_size, hidden, rngs)
        self.residual = _dense(hidden[-1], action_size, 0.01, rngs)
        self.log_std = nnx.Param(jnp.zeros((action_size,), jnp.float32))


class Critic(nnx.Module):
    """The state value V: R^O -> R."""

    def __init__(self, observation_size: int, hidden: Sequence[int], rngs: nnx.Rngs) -> None:
        self.features = Tower(observation_size, hidden, rngs)
        self.value = _dense(hidden[-1], 1, 1.0, rngs)

    def __call__(self, observation: Float[Array, "B O"]) -> Float[Array, "B"]:
        return self.value(self.features(observation))[:, 0]


@dataclass(frozen=True)
class Networks:
    """The static halves of policy and critic; parameters come and go as pure dicts."""

    policy: nnx.GraphDef
    critic: nnx.GraphDef
    observation_size: int
    action_size: int
    feature_size: int

    def bind_policy(self, parameters: Parameters) -> PolicyNetwork:
        return nnx.merge(self.policy, parameters)

    def value(self, parameters: Parameters, observation: Float[Array, "B O"]) -> Float[Array, "B"]:
        return nnx.merge(self.critic, parameters)(observation)


def make_networks(
    observation_size: int, action_size: int, hidden: Sequence[int], seed: int
) -> tuple[Networks, Parameters]:
    """The networks and their initial parameters `{"policy": ..., "critic": ...}`.

    Policy and critic draw from their own streams, so neither depends on the other's shape.
    """
    policy_key, critic_key = jax.random.split(jax.random.key(seed))
    policy, policy_parameters = nnx.split(
        PolicyNetwork(observation_size, action_size, hidden, nnx.Rngs(params=policy_key))
    )
    critic, critic_parameters = nnx.split(Critic(observation_size, hidden, nnx.Rngs(params=critic_key)))
    networks = Networks(policy, critic, observation_size, action_size, hidden[-1])
    return networks, {
        "policy": nnx.to_pure_dict(policy_parameters),
        "critic": nnx.to_pure_dict(critic_parameters),
    }
