"""The policy as it acts: N(h(psi(o)) + mu(psi(o)), Sigma) (paper, equation 5 and section 3.3).

The learner's update and the actors call the same functions, so both see the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from common.maths import running
from common.maths.networks import Networks, Parameters
from common.maths.rkhs.representation import Function, Representation
from common.maths.running import Moments


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Policy:
    """All that acting needs: a snapshot is one of these."""

    parameters: Parameters
    expansion: Function
    observations: Moments


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Mean:
    """The policy mean m = h + mu in its parts, and the features it is made from.

    features: the input of the kernel, z / sqrt(d), or observations for a learner without features.
    """

    features: Float[Array, "B d"]
    rkhs: Float[Array, "B A"]
    residual: Float[Array, "B A"]
    log_std: Float[Array, "A"]

    @property
    def total(self) -> Float[Array, "B A"]:
        return self.rkhs + self.residual


def evaluate(
    networks: Networks,
    representation: Representation[Any, Any],
    parameters: Parameters,
    expansion: Function,
    observation: Float[Array, "B O"],
) -> Mean:
    """The mean at standardised observations. With capacity 0 there is no h, and nothing is computed for it."""
    network = networks.bind_policy(parameters)
    z = network.features(observation)
    features = z * networks.feature_scale
    residual = network.residual(z)
    if expansion.capacity:
        rkhs = representation.evaluate(expansion, features)
    else:
        rkhs = jnp.zeros_like(residual)
    return Mean(features, rkhs, residual, network.log_std[...])


def act(
    networks: Networks,
    representation: Representation[Any, Any],
    policy: Policy,
    observation: Float[Array, "B O"],
    *,
    normalise: bool,
) -> Mean:
    """The mean at raw observations, whitened by the snapshot's moments where the run normalises them."""
    if normalise:
        observation = running.standardise(policy.observations, observation)
    return evaluate(networks, representation, policy.parameters, policy.expansion, observation)
