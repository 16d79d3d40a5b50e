"""Random Fourier features (Rahimi and Recht 2007): the gradient of a whole batch is one matrix product."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key

from common.kernels.kernel import RadialKernel
from common.maths.expansion import RepresentationState
from common.maths.gram import product
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

    kernel: RadialKernel
    seed: int

    def empty(self, feature_size: int, action_size: int) -> tuple[Embedding, RepresentationState]:
        weights = jnp.zeros((self.capacity, action_size), jnp.float32)
        key = jax.random.fold_in(jax.random.key(self.seed), 0xF0FE)
        directions = frequencies(self.kernel, key, self.capacity // 2, feature_size)
        return Embedding(directions, weights), RepresentationState(weights, jnp.zeros((), jnp.int32))

    def activations(self, function: Embedding, features: Float[Array, "B d"]) -> Float[Array, "B M"]:
        cosine, sine = cos_sin(product(features, function.directions.T))
        return jnp.concatenate([cosine, sine], axis=1) * (function.directions.shape[0] ** -0.5)


def frequencies(kernel: RadialKernel, key: Key[Array, ""], count: int, size: int) -> Float[Array, "F d"]:
    """Draws of the kernel's spectrum. A bias is allowed that is no greater than the error of so many draws."""
    g = jax.random.normal(key, (count, size), jnp.float32)
    u = jax.random.normal(jax.random.fold_in(key, 1), (count, 1), jnp.float32)
    return g * kernel.frequency_scale(u, count**-0.5, jnp)
