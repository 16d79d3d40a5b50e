"""Running mean and variance, merged batch by batch (Chan, Golub and LeVeque 1979)."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

_START_COUNT = 1e-4  # weight of the prior mean 0 and variance 1, as in PureJaxRL
_EPS = 1e-8


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Moments:
    """Mean and population variance of all values seen so far."""

    mean: Float[Array, "*shape"]
    variance: Float[Array, "*shape"]
    count: Float[Array, ""]


def start(shape: tuple[int, ...]) -> Moments:
    """Nothing seen: mean 0, variance 1."""
    return Moments(jnp.zeros(shape, jnp.float32), jnp.ones(shape, jnp.float32), jnp.asarray(_START_COUNT, jnp.float32))


def merge(moments: Moments, values: Float[Array, "B *shape"]) -> Moments:
    """The moments after `values` were seen too."""
    batch = jnp.asarray(values.shape[0], jnp.float32)
    batch_mean = jnp.mean(values, axis=0)
    total = moments.count + batch
    delta = batch_mean - moments.mean
    squares = (
        moments.variance * moments.count
        + jnp.var(values, axis=0) * batch
        + jnp.square(delta) * moments.count * batch / total
    )
    return Moments(moments.mean + delta * batch / total, squares / total, total)


def standardise(moments: Moments, values: Float[Array, "*batch shape"]) -> Float[Array, "*batch shape"]:
    """Values less the mean, over the standard deviation."""
    return (values - moments.mean) * jax.lax.rsqrt(moments.variance + _EPS)


def merge_and_standardise(
    moments: Moments, values: Float[Array, "T B *shape"]
) -> tuple[Moments, Float[Array, "T B *shape"]]:
    """Step by step: merge the step's values, then standardise them by the moments that result."""

    def one_step(moments: Moments, at_t: Float[Array, "B *shape"]) -> tuple[Moments, Float[Array, "B *shape"]]:
        moments = merge(moments, at_t)
        return moments, standardise(moments, at_t)

    return jax.lax.scan(one_step, moments, values)


def merge_and_scale(
    moments: Moments, returns: Float[Array, "T B"], rewards: Float[Array, "T B"]
) -> tuple[Moments, Float[Array, "T B"]]:
    """Step by step: merge the step's discounted returns, then scale its rewards by the moments that result."""

    def one_step(moments: Moments, at_t: tuple[Array, Array]) -> tuple[Moments, Float[Array, "B"]]:
        returns_t, rewards_t = at_t
        moments = merge(moments, returns_t)
        return moments, scale(moments, rewards_t)

    return jax.lax.scan(one_step, moments, (returns, rewards))


def scale(moments: Moments, values: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Values over the standard deviation, the mean left in (rewards)."""
    return values * jax.lax.rsqrt(moments.variance + _EPS)
