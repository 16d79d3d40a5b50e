"""Landmarks (Williams and Seeger 2001): the functional gradient projected onto the span of M kernels K(c_i, .)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from common.maths.expansion import Expansion, RepresentationState
from common.maths.gram import gram, product
from common.maths.rkhs.representation import OfKernels, SampleFeatures


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NystromState(RepresentationState):
    """`whitening` is K_LL^-1/2 of the landmarks; `added` counts updates, `chosen` is the one they were chosen at."""

    whitening: Float[Array, "M M"]
    chosen: Int[Array, ""]


@final
@dataclass(frozen=True)
class Nystrom(OfKernels[NystromState]):
    """h = phi(.) @ theta with phi(z) = K_LL^-1/2 K(L, z), kept as the weights K_LL^-1/2 theta of the landmarks.

    So h costs what M centres cost, and a gradient over n transitions becomes weights by a product with K(L, Z): the
    orthogonal projection of the functional gradient, K_LL^-1 K(L, Z) alpha.

    Landmarks are the features of M transitions spread evenly over the first batch, and again over that of every
    `landmarks_every`-th update (0: never); h and v are then projected onto the new ones.
    """

    landmarks_every: int

    def empty(self, feature_size: int, action_size: int) -> tuple[Expansion, NystromState]:
        m = self.capacity
        weights = jnp.zeros((m, action_size), jnp.float32)
        centres = jnp.zeros((m, feature_size), jnp.float32)
        zero = jnp.zeros((), jnp.int32)
        return Expansion(centres, weights), NystromState(weights, zero, jnp.zeros((m, m), jnp.float32), zero)

    def average(
        self,
        function: Expansion,
        state: NystromState,
        features: Float[Array, "n d"],
        coefficients: Float[Array, "n A"],
        sample_features: SampleFeatures,
        *,
        decay: float,
    ) -> tuple[Expansion, NystromState]:
        due = state.added == 0
        if self.landmarks_every:
            due |= state.added % self.landmarks_every == 0
        function, state = jax.lax.cond(
            due, self._choose, lambda h, v, _: (h, v), function, state, sample_features(self.capacity)
        )
        gradient = _solve(state.whitening, product(gram(self.kernel, function.centres, features), coefficients))
        velocity = decay * state.velocity + (1.0 - decay) * gradient
        return function, NystromState(velocity, state.added + 1, state.whitening, state.chosen)

    def gradient_gram(
        self, function: Expansion, state: NystromState, features: Float[Array, "G d"], samples: int
    ) -> Float[Array, "G G"]:
        phi = product(gram(self.kernel, features, function.centres), state.whitening)
        return product(phi, phi.T)

    def retreat(
        self, old: tuple[Expansion, NystromState], averaged: tuple[Expansion, NystromState], part: Float[Array, ""]
    ) -> tuple[Expansion, NystromState]:
        """The landmarks of `old` stay until the next choice; v and the gradient in it are projected back onto them."""
        (function, before), (new, after) = old, averaged
        across = gram(self.kernel, function.centres, new.centres)
        velocity = _solve(before.whitening, product(across, after.velocity))
        return function, NystromState(velocity, after.added, before.whitening, before.chosen)

    def size(self, function: Expansion, state: NystromState) -> Int[Array, ""]:
        return jnp.where(state.added > 0, function.capacity, 0)

    def age(self, state: NystromState, samples: int) -> Float[Array, ""]:
        return jnp.maximum(state.added - 1 - state.chosen, 0).astype(jnp.float32)

    def _choose(
        self, function: Expansion, state: NystromState, landmarks: Float[Array, "M d"]
    ) -> tuple[Expansion, NystromState]:
        """New landmarks, and h and v projected onto them."""
        whitening = inverse_root(gram(self.kernel, landmarks, landmarks))
        across = gram(self.kernel, landmarks, function.centres)
        weights = _solve(whitening, product(across, function.weights))
        velocity = _solve(whitening, product(across, state.velocity))
        return Expansion(landmarks, weights), NystromState(velocity, state.added, whitening, state.added)


def inverse_root(matrix: Float[Array, "M M"]) -> Float[Array, "M M"]:
    """The inverse square root of a positive semi-definite matrix.

    Features lie close together, so Gram matrices have eigenvalues below rounding; the jitter, M times the
    rounding error of the largest one, keeps those from being blown up.
    """
    values, vectors = jnp.linalg.eigh(matrix)
    jitter = matrix.shape[0] * jnp.finfo(matrix.dtype).eps * jnp.max(jnp.abs(values))
    scale = jax.lax.rsqrt(jnp.maximum(values, 0.0) + jnp.maximum(jitter, jnp.finfo(matrix.dtype).tiny))
    return product(vectors * scale, vectors.T)


def _solve(whitening: Float[Array, "M M"], right: Float[Array, "M A"]) -> Float[Array, "M A"]:
    """K_LL^-1 times the right side."""
    return product(whitening, product(whitening, right))
