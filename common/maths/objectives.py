"""Objectives of the networks and the expansion, as functions of ratio and advantage."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float


def clipped(ratio: Float[Array, "*batch"], advantage: Float[Array, "*batch"], *, clip: float) -> Float[Array, "*batch"]:
    """PPO's objective min(r A, clip(r, 1 - clip, 1 + clip) A) (Schulman et al. 2017, equation 7)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantage)


def drift(
    log_ratio: Float[Array, "*batch"], advantage: Float[Array, "*batch"], *, alpha: float, beta: float
) -> Float[Array, "*batch"]:
    """DPO's drift (Lu et al. 2022, equation 7), at least zero and zero at r = 1.

    relu((r - 1) A - alpha tanh((r - 1) A / alpha)) where A >= 0, and relu(log r A - beta tanh(log r A / beta))
    elsewhere. The paper's section B.1 writes r A in place of log r A, which makes the second branch zero
    everywhere; docs/method.md says why Lu et al. are followed.
    """
    gain = jnp.expm1(log_ratio) * advantage
    loss = log_ratio * advantage
    positive = gain - alpha * jnp.tanh(gain / alpha)
    negative = loss - beta * jnp.tanh(loss / beta)
    return jnp.maximum(jnp.where(advantage >= 0.0, positive, negative), 0.0)


def drift_slope(
    log_ratio: Float[Array, "*batch"], advantage: Float[Array, "*batch"], *, alpha: float, beta: float
) -> Float[Array, "*batch"]:
    """The derivative of `drift` with respect to log r: A r tanh^2((r - 1) A / alpha) or A tanh^2(log r A / beta).

    It has the sign of A where r has moved the way A pushes it, and is zero elsewhere.
    """
    return jax.grad(lambda at: jnp.sum(drift(at, advantage, alpha=alpha, beta=beta)))(log_ratio)


def drifted(
    log_ratio: Float[Array, "*batch"], advantage: Float[Array, "*batch"], *, alpha: float, beta: float
) -> Float[Array, "*batch"]:
    """DPO's objective r A - drift."""
    return jnp.exp(log_ratio) * advantage - drift(log_ratio, advantage, alpha=alpha, beta=beta)


def clipped_value_loss(
    value: Float[Array, "*batch"],
    old_value: Float[Array, "*batch"],
    target: Float[Array, "*batch"],
    *,
    clip: float,
) -> Float[Array, ""]:
    """Half the mean of the larger squared error, the new value as it is or held within `clip` of the old."""
    held = old_value + jnp.clip(value - old_value, -clip, clip)
    return 0.5 * jnp.mean(jnp.maximum(jnp.square(value - target), jnp.square(held - target)))


def normalised(advantage: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Mean 0 and standard deviation 1 over the batch."""
    return (advantage - jnp.mean(advantage)) / (jnp.std(advantage) + 1e-8)
