"""Gram matrices, and the matrix products that they and what is solved with them need in full precision.

On GPUs, JAX multiplies float32 matrices in TF32, with ten bits of mantissa, unless told otherwise. A squared distance
is the small difference of large numbers, |x|^2 + |y|^2 - 2 <x, y>: for an observation of 244 whitened numbers and the
Laplacian kernel, K(x, x) would be 0.6.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from common.kernels import Kernel


def product(x: Float[Array, "B K"], y: Float[Array, "K M"]) -> Float[Array, "B M"]:
    """x @ y, every product in float32 on every device."""
    return jnp.matmul(x, y, precision=jax.lax.Precision.HIGHEST)


def gram(kernel: Kernel, x: Float[Array, "B d"], y: Float[Array, "M d"]) -> Float[Array, "B M"]:
    """K(x_i, y_j) for all pairs: one (B, d) x (d, M) product and an elementwise pass."""
    x_squared = jnp.sum(jnp.square(x), axis=1)[:, None]
    y_squared = jnp.sum(jnp.square(y), axis=1)[None, :]
    return kernel.of(product(x, y.T), x_squared, y_squared, jnp)


def diagonal(kernel: Kernel, x: Float[Array, "B d"]) -> Float[Array, "B"]:
    """K(x_i, x_i), without the rest of the Gram matrix."""
    squared = jnp.sum(jnp.square(x), axis=1)
    return jax.vmap(lambda s: kernel.of(s[None, None], s[None, None], s[None, None], jnp)[0, 0])(squared)


def squared_distances(x: Float[Array, "n d"], y: Float[Array, "M d"]) -> Float[Array, "n M"]:
    """|x_i - y_j|^2 for all pairs."""
    x_squared, y_squared = jnp.sum(x * x, axis=1)[:, None], jnp.sum(y * y, axis=1)[None, :]
    return jnp.maximum(x_squared + y_squared - 2.0 * product(x, y.T), 0.0)
