"""Kernels as functions of inner products; how those are computed is `gram`'s business.

A kernel sees `<x, y>`, `|x|^2` and `|y|^2`, so that a Gram matrix costs one matrix product.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

Kernel = Callable[[Float[Array, "B M"], Float[Array, "B 1"], Float[Array, "1 M"]], Float[Array, "B M"]]
"""(<x, y>, |x|^2, |y|^2) -> K(x, y), elementwise over all pairs."""


def gaussian(bandwidth: float) -> Kernel:
    """K(x, y) = exp(-|x - y|^2 / bandwidth), with bandwidth = sigma^2 (paper, section 3.1). Positive definite."""

    def kernel(
        products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"]
    ) -> Float[Array, "B M"]:
        return jnp.exp(-_distance_squared(products, x_squared, y_squared) / bandwidth)

    return kernel


def laplacian(bandwidth: float) -> Kernel:
    """K(x, y) = exp(-|x - y| / bandwidth), the norm Euclidean (paper, section D.4). Positive definite."""

    def kernel(
        products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"]
    ) -> Float[Array, "B M"]:
        squared = _distance_squared(products, x_squared, y_squared)
        # The root has no derivative at 0; there K is at its maximum, and 0 is the right one of its subgradients.
        apart = squared > 0.0
        distance = jnp.where(apart, jnp.sqrt(jnp.where(apart, squared, 1.0)), 0.0)
        return jnp.exp(-distance / bandwidth)

    return kernel


def linear() -> Kernel:
    """K(x, y) = <x, y> (paper, section D.4). Positive semi-definite of rank d: h is a linear map."""

    def kernel(
        products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"]
    ) -> Float[Array, "B M"]:
        return products

    return kernel


def sigmoid(slope: float, offset: float) -> Kernel:
    """K(x, y) = tanh(slope <x, y> + offset) (paper, section D.4).

    Not positive semi-definite: with slope 1 and offset -1 already K(x, x) < 0 for |x| < 1. There is no RKHS of it; h is
    a function all the same, but norms and projections in the RKHS have no meaning.
    """

    def kernel(
        products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"]
    ) -> Float[Array, "B M"]:
        return jnp.tanh(slope * products + offset)

    return kernel


def gram(kernel: Kernel, x: Float[Array, "B d"], y: Float[Array, "M d"]) -> Float[Array, "B M"]:
    """K(x_i, y_j) for all pairs: one (B, d) x (d, M) product and an elementwise pass."""
    x_squared = jnp.sum(jnp.square(x), axis=1)[:, None]
    y_squared = jnp.sum(jnp.square(y), axis=1)[None, :]
    return kernel(x @ y.T, x_squared, y_squared)


def diagonal(kernel: Kernel, x: Float[Array, "B d"]) -> Float[Array, "B"]:
    """K(x_i, x_i), without the rest of the Gram matrix."""
    squared = jnp.sum(jnp.square(x), axis=1)
    return jax.vmap(lambda s: kernel(s[None, None], s[None, None], s[None, None])[0, 0])(squared)


def make_kernel(name: str, bandwidth: float, slope: float = 1.0, offset: float = 0.0) -> Kernel:
    """The kernel of that name (`common.config.rkhs.KERNELS`); slope and offset are the sigmoid's."""
    kernels: dict[str, Callable[[], Kernel]] = {
        "gaussian": lambda: gaussian(bandwidth),
        "laplacian": lambda: laplacian(bandwidth),
        "linear": linear,
        "sigmoid": lambda: sigmoid(slope, offset),
    }
    return kernels[name]()


def _distance_squared(
    products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"]
) -> Float[Array, "B M"]:
    # Rounding can make the distance of a point to itself slightly negative, and K greater than 1.
    return jnp.maximum(x_squared + y_squared - 2.0 * products, 0.0)
