"""Ridge regression from its normal equations, judged on data that it has not seen.

The data lie in two halves, each with its own equations: the fit to one half is judged on the other without another
pass over the data, and their sum is the fit to all.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

_LEAST = 1e-20  # keeps a residual that is zero everywhere from being divided by


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Equations:
    """Sums over the data of each half: phi phi^T, phi y and y^2."""

    matrix: Float[Array, "2 M M"]
    right: Float[Array, "2 M"]
    square: Float[Array, "2"]


def no_equations(size: int) -> Equations:
    """The equations of no data."""
    return Equations(
        jnp.zeros((2, size, size), jnp.float32), jnp.zeros((2, size), jnp.float32), jnp.zeros((2,), jnp.float32)
    )


def equations(phi: Float[Array, "2 B M"], y: Float[Array, "2 B"]) -> Equations:
    """The equations of data in two halves."""
    return Equations(
        jnp.einsum("hbi,hbj->hij", phi, phi), jnp.einsum("hbi,hb->hi", phi, y), jnp.sum(jnp.square(y), axis=1)
    )


def discounted_sum(old: Equations, new: Equations, weight: float) -> Equations:
    """The new equations plus the old ones by their weight: recursive least squares with forgetting."""
    if weight == 0.0:
        return new
    return jax.tree.map(lambda x, y: weight * x + y, old, new)


def solve(matrix: Float[Array, "M M"], right: Float[Array, "M"], ridge: float) -> Float[Array, "M"]:
    """(A + lambda I)^-1 b, lambda the ridge times the mean eigenvalue of A."""
    size = matrix.shape[0]
    penalty = ridge * jnp.trace(matrix) / size
    system = matrix + penalty * jnp.eye(size, dtype=matrix.dtype)
    return jax.scipy.linalg.solve(system, right, assume_a="pos")


def held_out_r2(fitted: Equations, judged: Equations, ridge: float) -> Float[Array, ""]:
    """R^2 of each half's fit on the other half, against predicting zero.

    1 - sum (y - phi theta)^2 / sum y^2, theta from the other half; the sum of squares needs the equations alone:
    y^T y - 2 theta^T b + theta^T A theta.

    Args:
        fitted: what the weights are solved from.
        judged: what they are judged on; of the newest data, while `fitted` may hold earlier data too.
    """
    weights = jax.vmap(lambda a, b: solve(a, b, ridge))(fitted.matrix, fitted.right)[::-1]
    explained = 2.0 * jnp.sum(weights * judged.right) - jnp.einsum("hi,hij,hj->", weights, judged.matrix, weights)
    return explained / jnp.maximum(jnp.sum(judged.square), _LEAST)
