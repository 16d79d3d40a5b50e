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

from common.learners import LEARNERS, Learner
from common.maths.mixed_precision import Precision, bfloat16_dot_general

Parameters = dict
"""A nested dict of arrays: what `nnx.to_pure_dict` makes of a module."""

_HEAD_SCALE = 0.01  # the policy starts near mean 0 (PureJaxRL)


def _dense(inputs: int, outputs: int, scale: float, rngs: nnx.Rngs, precision: Precision = "float32") -> nnx.Linear:
    return nnx.Linear(
        inputs,
        outputs,
        dot_general=bfloat16_dot_general if precision == "bfloat16" else jax.lax.dot_general,
        kernel_init=nnx.initializers.orthogonal(scale),
        bias_init=nnx.initializers.zeros,
        rngs=rngs,
    )


class Tower(nnx.Module):
    """Dense layers with tanh, orthogonally initialised: R^inputs -> R^widths[-1]; the identity without widths.

    `precision` is that of its products. Weights, sums and what it returns are float32.
    """

    def __init__(self, inputs: int, widths: Sequence[int], rngs: nnx.Rngs, precision: Precision) -> None:
        sizes, scale = [inputs, *widths], float(np.sqrt(2))
        self.layers = nnx.List(_dense(a, b, scale, rngs, precision) for a, b in itertools.pairwise(sizes))

    def __call__(self, x: Float[Array, "B inputs"]) -> Float[Array, "B d"]:
        for layer in self.layers:
            x = jnp.tanh(layer(x))
        return x


class NoResidual(nnx.Module):
    """mu = 0: for the learners whose mean is h alone."""

    def __init__(self, outputs: int) -> None:
        self.outputs = outputs

    def __call__(self, z: Float[Array, "B d"]) -> Float[Array, "B outputs"]:
        return jnp.zeros((z.shape[0], self.outputs), z.dtype)


class TwoHeads(nnx.Module):
    """The usual last layer plus a second fully connected one beside it (paper, section D.3)."""

    def __init__(self, inputs: int, outputs: int, rngs: nnx.Rngs) -> None:
        self.head = _dense(inputs, outputs, _HEAD_SCALE, rngs)
        self.second = _dense(inputs, outputs, _HEAD_SCALE, rngs)

    def __call__(self, z: Float[Array, "B d"]) -> Float[Array, "B outputs"]:
        return self.head(z) + self.second(z)


class PolicyNetwork(nnx.Module):
    """The part of the policy that gradients train: psi, mu and log_std, as far as the learner has them."""

    def __init__(
        self,
        learner: Learner,
        observation_size: int,
        action_size: int,
        hidden: Sequence[int],
        rngs: nnx.Rngs,
        precision: Precision = "float32",
    ) -> None:
        widths = hidden if learner.features else ()
        self.features = Tower(observation_size, widths, rngs, precision)
        inputs = [observation_size, *widths][-1]
        self.residual: nnx.Linear | NoResidual | TwoHeads
        if learner.residual == "head":
            self.residual = _dense(inputs, action_size, _HEAD_SCALE, rngs)
        elif learner.residual == "two heads":
            self.residual = TwoHeads(inputs, action_size, rngs)
        else:
            self.residual = NoResidual(action_size)
        self.log_std = nnx.Param(jnp.zeros((action_size,), jnp.float32))


def within_bound(parameters: Parameters, max_log_std: float | None) -> Parameters:
    """The parameters with every |log_std| at most the bound; as they are where there is none."""
    if max_log_std is None:
        return parameters
    log_std = jnp.clip(parameters["policy"]["log_std"], -max_log_std, max_log_std)
    return {**parameters, "policy": {**parameters["policy"], "log_std": log_std}}


class Critic(nnx.Module):
    """The state value V: R^O -> R."""

    def __init__(
        self, observation_size: int, hidden: Sequence[int], rngs: nnx.Rngs, precision: Precision = "float32"
    ) -> None:
        self.features = Tower(observation_size, hidden, rngs, precision)
        self.value = _dense(hidden[-1], 1, 1.0, rngs)

    def __call__(self, observation: Float[Array, "B O"]) -> Float[Array, "B"]:
        return self.value(self.features(observation))[:, 0]


@dataclass(frozen=True)
class Networks:
    """The static halves of policy and critic; parameters come and go as pure dicts.

    feature_size: size d of what the kernel sees.
    feature_scale: what features are multiplied by for the kernel: d^-1/2, so that distances are of order one and a
        bandwidth means the same at every size; 1 where the kernel sees observations.
    """

    policy: nnx.GraphDef
    critic: nnx.GraphDef
    observation_size: int
    action_size: int
    feature_size: int
    feature_scale: float

    def bind_policy(self, parameters: Parameters) -> PolicyNetwork:
        return nnx.merge(self.policy, parameters)

    def value(self, parameters: Parameters, observation: Float[Array, "B O"]) -> Float[Array, "B"]:
        return nnx.merge(self.critic, parameters)(observation)

    def critic_features(self, parameters: Parameters, observation: Float[Array, "B O"]) -> Float[Array, "B d"]:
        """The input of the critic's last layer, over the root of its size as the features of the kernel are."""
        z = nnx.merge(self.critic, parameters).features(observation)
        return z * (z.shape[-1] ** -0.5)


def make_networks(
    observation_size: int,
    action_size: int,
    hidden: Sequence[int],
    seed: int,
    learner: Learner = LEARNERS["reskpn"],
    precision: Precision = "float32",
) -> tuple[Networks, Parameters]:
    """The networks and their initial parameters `{"policy": ..., "critic": ...}`.

    Policy and critic draw from their own streams, so neither depends on the other's shape. `precision` is that of the
    hidden layers' products; heads and parameters are float32.
    """
    policy_key, critic_key = jax.random.split(jax.random.key(seed))
    policy, policy_parameters = nnx.split(
        PolicyNetwork(learner, observation_size, action_size, hidden, nnx.Rngs(params=policy_key), precision)
    )
    critic, critic_parameters = nnx.split(Critic(observation_size, hidden, nnx.Rngs(params=critic_key), precision))
    feature_size = hidden[-1] if learner.features else observation_size
    scale = feature_size**-0.5 if learner.features else 1.0
    networks = Networks(policy, critic, observation_size, action_size, feature_size, scale)
    return networks, {
        "policy": nnx.to_pure_dict(policy_parameters),
        "critic": nnx.to_pure_dict(critic_parameters),
    }
