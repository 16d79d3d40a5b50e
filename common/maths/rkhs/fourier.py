"""Random Fourier features (Rahimi and Recht 2007): the gradient of a whole batch is one matrix product."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key

from common.maths.expansion import RepresentationState
from common.maths.rkhs.representation import Embedding, OfFeatures
from common.maths.trigonometry import cos_sin


@final
@dataclass(frozen=True)
class Fourier(OfFeatures):
    """phi(x) = sqrt(2/M) [cos(W x), sin(W x)] for M/2 frequencies W drawn from the kernel's spectrum.

    E[phi(x) @ phi(y)] = E[cos(w (x - y))] = K(x, y), with an error of the order M^-1/2. As pairs, M features cost the
    products of M/2, and for the Gaussian kernel have less error than cosines of random phase (Sutherland and
    Schneider 2015).
    """

    kernel_name: str
    bandwidth: float
    seed: int

    def empty(self, feature_size: int, action_size: int) -> tuple[Embedding, RepresentationState]:
        weights = jnp.zeros((self.capacity, action_size), jnp.float32)
        key = jax.random.fold_in(jax.random.key(self.seed), 0xF0FE)
        draw = gaussian_frequencies if self.kernel_name == "gaussian" else laplacian_frequencies
        frequencies = draw(key, self.capacity // 2, feature_size, self.bandwidth)
        return Embedding(frequencies, weights), RepresentationState(weights, jnp.zeros((), jnp.int32))

    def activations(self, function: Embedding, features: Float[Array, "B d"]) -> Float[Array, "B M"]:
        cosine, sine = cos_sin(features @ function.directions.T)
        return jnp.concatenate([cosine, sine], axis=1) * (function.directions.shape[0] ** -0.5)


def gaussian_frequencies(key: Key[Array, ""], count: int, size: int, bandwidth: float) -> Float[Array, "F d"]:
    """The spectrum of exp(-r^2 / bandwidth): N(0, 2/bandwidth I)."""
    return jax.random.normal(key, (count, size), jnp.float32) * (2.0 / bandwidth) ** 0.5


def laplacian_frequencies(key: Key[Array, ""], count: int, size: int, bandwidth: float) -> Float[Array, "F d"]:
    """The spectrum of exp(-r / bandwidth), r the Euclidean distance: a multivariate Cauchy distribution.

    For w = g / (|u| bandwidth) with g ~ N(0, I) and u ~ N(0, 1): E[cos(w x)] = E[exp(-r^2 / (2 u^2 bandwidth^2))], and
    1/u^2 is Levy distributed, whose Laplace transform is E[exp(-t / (2 u^2))] = exp(-sqrt(t)).
    """
    numerator, denominator = jax.random.split(key)
    g = jax.random.normal(numerator, (count, size), jnp.float32)
    u = jax.random.normal(denominator, (count, 1), jnp.float32)
    return g / (jnp.abs(u) * bandwidth)
