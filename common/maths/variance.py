"""Variance of functional gradients (paper, sections 3.1 and 3.3, appendices A to C)."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from common.kernels import Kernel
from common.kernels.linear import Linear
from common.maths.gram import diagonal, gram


def gradient_variance(
    kernel: Kernel, features: Float[Array, "G d"], coefficients: Float[Array, "G A"]
) -> Float[Array, ""]:
    """Equation 10: the sample variance 1/G sum_t |x_t - mean|^2 of the gradients x_t = alpha_t K(z_t, .) in the RKHS.

    Expanded by the reproducing property: mean_t |alpha_t|^2 K(z_t, z_t) - mean_ij (alpha_i alpha_j) K(z_i, z_j). One
    Gram matrix of G transitions.
    """
    return _variance(gram(kernel, features, features), diagonal(kernel, features), coefficients)


def represented_variance(matrix: Float[Array, "G G"], coefficients: Float[Array, "G A"]) -> Float[Array, ""]:
    """Equation 10 for gradients alpha_t g_t, of functions g_t with this Gram matrix in place of K(z_t, .)."""
    return _variance(matrix, jnp.diagonal(matrix), coefficients)


def _variance(
    matrix: Float[Array, "G G"], own: Float[Array, "G"], coefficients: Float[Array, "G A"]
) -> Float[Array, ""]:
    each = jnp.mean(jnp.sum(jnp.square(coefficients), axis=1) * own)
    shared = jnp.sum(coefficients * (matrix @ coefficients)) / coefficients.shape[0] ** 2
    return jnp.maximum(each - shared, 0.0)  # rounding can pass 0 where all gradients are the same


def linear_ratio(kernel: Kernel, features: Float[Array, "G d"], coefficients: Float[Array, "G A"]) -> Float[Array, ""]:
    """The ratio R of section 3.1, measured: the variance of the RKHS gradient over that of the linear policy theta^T s.

    The gradient of the linear policy at the same transitions, alpha_t s_t^T, is the one of the linear kernel.
    """
    own = gradient_variance(kernel, features, coefficients)
    return own / (gradient_variance(Linear(), features, coefficients) + jnp.finfo(own.dtype).tiny)


def score_variance(
    slope: Float[Array, "*batch"],
    offset: Float[Array, "*batch"],
    mean: Float[Array, "*batch"],
    variance: Float[Array, ""],
) -> Float[Array, "*batch"]:
    """Lemma 3.1: Var over a ~ N(m, Sigma) of Sigma^-1 (a - m) (c a + d) = 2 c^2 + Sigma^-1 (c m + d)^2, one action.

    Args:
        slope, offset: c and d of an action value that is linear in the action.
        mean, variance: m and Sigma.
    """
    return 2.0 * jnp.square(slope) + jnp.square(slope * mean + offset) / variance


def variance_ratio(
    kernel: Kernel,
    state: Float[Array, "B d"],
    of_rkhs: tuple[Float[Array, "B"], Float[Array, "B"], Float[Array, "B"]],
    of_linear: tuple[Float[Array, "B"], Float[Array, "B"], Float[Array, "B"]],
    variance: Float[Array, ""],
) -> Float[Array, "B"]:
    """The ratio R of Lemma 3.1 at every state: K(s, s) / |s|^2 times the quotient of the two score variances.

    Each policy is given as (slope, offset, mean). The lemma has K^2(s, s); its proof has both K(s, s) and K(s, .) in
    one product. |alpha K(s, .)|^2 = alpha^2 K(s, s) in the RKHS, so that is used; for Gaussian and Laplacian kernels,
    where K(s, s) = 1, it is the same.
    """
    quotient = score_variance(*of_rkhs, variance) / score_variance(*of_linear, variance)
    return diagonal(kernel, state) / jnp.sum(jnp.square(state), axis=1) * quotient


def three_gradients(
    action: Float[Array, "G A"],
    rkhs: Float[Array, "G A"],
    residual: Float[Array, "G A"],
    log_std: Float[Array, "A"],
    value: Float[Array, "G"],
    advantage: Float[Array, "G"],
) -> tuple[Float[Array, "G A"], Float[Array, "G A"], Float[Array, "G A"]]:
    """The coefficients that Theorem 3.2 orders by variance, at transitions of one policy and without step size.

    Sigma^-1 (a - h) Q, Sigma^-1 (a - h) A and Sigma^-1 (a - h - mu) A, with Q = A + V (equations 6, 7 and 8).
    """
    precision = jnp.exp(-2.0 * log_std)
    without = (action - rkhs) * precision
    return (
        without * (advantage + value)[:, None],
        without * advantage[:, None],
        (without - residual * precision) * advantage[:, None],
    )
