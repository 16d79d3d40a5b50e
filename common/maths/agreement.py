"""The agreement of a batch with itself: how much of a functional gradient is signal."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

_LEAST = 1e-30  # keeps a gradient of zero from being divided by


def squared_cosine(phi: Float[Array, "n M"], coefficients: Float[Array, "n A"]) -> Float[Array, ""]:
    """cos^2 of the functional gradients of the even and of the odd rows in the RKHS; 0 where they point apart.

    Of a batch in the order of its steps, with an even number of environments, these are two halves of the environments.

    Args:
        phi: orthonormal functions of the RKHS at the transitions.
        coefficients: alpha_k; the gradient of a half is the sum of alpha_k phi(z_k) over it.
    """
    first, second = (phi[i::2].T @ coefficients[i::2] for i in (0, 1))
    norms = jnp.sum(jnp.square(first)) * jnp.sum(jnp.square(second))
    cosine = jnp.sum(first * second) / jnp.sqrt(jnp.maximum(norms, _LEAST))
    return jnp.square(jnp.maximum(cosine, 0.0))
