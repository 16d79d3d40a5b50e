"""Kernels as functions of inner products; how those are computed is `gram`'s business.

A kernel sees `<x, y>`, `|x|^2` and `|y|^2`, so that a Gram matrix costs one matrix product.
"""

from __future__ import annotations

from collections.abc import Callable

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
        # Rounding can make the distance of a point to itself slightly negative, and K greater than 1.
        distance_squared = jnp.maximum(x_squared + y_squared - 2.0 * products, 0.0)
        return jnp.exp(-distance_squared / bandwidth)

    return kernel


def gram(kernel: Kernel, x: Float[Array, "B d"], y: Float[Array, "M d"]) -> Float[Array, "B M"]:
    """K(x_i, y_j) for all pairs: one (B, d) x (d, M) product and an elementwise pass."""
    x_squared = jnp.sum(jnp.square(x), axis=1)[:, None]
    y_squared = jnp.sum(jnp.square(y), axis=1)[None, :]
    return kernel(x @ y.T, x_squared, y_squared)


def make_kernel(name: str, bandwidth: float) -> Kernel:
    """The kernel of that name (`common.settings.KERNELS`)."""
    return {"gaussian": gaussian}[name](bandwidth)
