"""The diagonal Gaussian that the policy is: N(mean, diag(exp(2 log_std)))."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key

_HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)


def log_prob(
    mean: Float[Array, "*batch A"], log_std: Float[Array, "A"], action: Float[Array, "*batch A"]
) -> Float[Array, "*batch"]:
    """log N(action; mean, diag(exp(2 log_std)))."""
    standardised = (action - mean) * jnp.exp(-log_std)
    return jnp.sum(-0.5 * jnp.square(standardised) - log_std - _HALF_LOG_TWO_PI, axis=-1)


def sample(key: Key[Array, ""], mean: Float[Array, "*batch A"], log_std: Float[Array, "A"]) -> Float[Array, "*batch A"]:
    """One action for each mean."""
    return mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)


def entropy(log_std: Float[Array, "A"]) -> Float[Array, ""]:
    """Differential entropy in nats."""
    return jnp.sum(log_std + 0.5 + _HALF_LOG_TWO_PI)


def score(
    mean: Float[Array, "*batch A"], log_std: Float[Array, "A"], action: Float[Array, "*batch A"]
) -> Float[Array, "*batch A"]:
    """Gradient of the log-probability in the mean: Sigma^-1 (a - mean)."""
    return (action - mean) * jnp.exp(-2.0 * log_std)


def kl_of_means(
    mean: Float[Array, "*batch A"], other: Float[Array, "*batch A"], log_std: Float[Array, "A"]
) -> Float[Array, "*batch"]:
    """KL divergence between two Gaussians that differ only in their means."""
    return 0.5 * jnp.sum(jnp.square((mean - other) * jnp.exp(-log_std)), axis=-1)
