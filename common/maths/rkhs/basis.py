"""The first functions of an orthonormal basis of the Gaussian kernel's space (a predefined basis, as Mazoure 2020)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from common.kernels.gaussian import Gaussian
from common.maths.expansion import RepresentationState
from common.maths.gram import product
from common.maths.rkhs.representation import Embedding, OfFeatures


@dataclass(frozen=True)
class _Degree:
    """The functions of one degree: each is a function of the degree below times a variable times a factor."""

    parent: np.ndarray
    variable: np.ndarray
    factor: np.ndarray


@final
@dataclass(frozen=True)
class Basis(OfFeatures):
    """e_a(y) = exp(-|y|^2/s2) prod_i sqrt((2/s2)^a_i / a_i!) y_i^a_i, multi-indices a in order of their degree.

    These are an orthonormal basis of the RKHS of exp(-|x-y|^2/s2) (Steinwart, Hush and Scovel 2006): by the series of
    exp(2 x y / s2), sum_a e_a(x) e_a(y) = K(x, y). Over d = 256 variables degree 2 alone has 32,896 functions, which
    is why the paper calls the approach infeasible. So y are `variables` coordinates of the features along random
    orthonormal directions, scaled by sqrt(d / variables) to keep distances; with as many variables as features, y = x.
    """

    kernel: Gaussian
    variables: int
    seed: int

    def empty(self, feature_size: int, action_size: int) -> tuple[Embedding, RepresentationState]:
        weights = jnp.zeros((self.capacity, action_size), jnp.float32)
        return Embedding(self._directions(feature_size), weights), RepresentationState(
            weights, jnp.zeros((), jnp.int32)
        )

    def activations(self, function: Embedding, features: Float[Array, "B d"]) -> Float[Array, "B M"]:
        y = product(features, function.directions.T)
        level = jnp.exp(-jnp.sum(jnp.square(y), axis=1, keepdims=True) / self.kernel.bandwidth)
        levels = [level]
        for degree in self._degrees(function.directions.shape[0]):
            level = level[:, degree.parent] * y[:, degree.variable] * jnp.asarray(degree.factor, y.dtype)
            levels.append(level)
        return jnp.concatenate(levels, axis=1)

    def _directions(self, feature_size: int) -> Float[Array, "F d"]:
        if self.variables >= feature_size:
            return jnp.eye(feature_size, dtype=jnp.float32)
        key = jax.random.fold_in(jax.random.key(self.seed), 0xBA51)
        columns, _ = jnp.linalg.qr(jax.random.normal(key, (feature_size, self.variables), jnp.float32))
        return columns.T * (feature_size / self.variables) ** 0.5

    def _degrees(self, variables: int) -> list[_Degree]:
        """Degrees 1, 2, ... until there are `capacity` functions with that of degree 0."""
        below: dict[tuple[int, ...], int] = {(): 0}
        degrees: list[_Degree] = []
        left = self.capacity - 1
        while left > 0:
            words = list(combinations_with_replacement(range(variables), len(degrees) + 1))[:left]
            degrees.append(
                _Degree(
                    parent=np.array([below[word[:-1]] for word in words]),
                    variable=np.array([word[-1] for word in words]),
                    factor=np.array([np.sqrt(2.0 / self.kernel.bandwidth / word.count(word[-1])) for word in words]),
                )
            )
            below = {word: i for i, word in enumerate(words)}
            left -= len(words)
        return degrees
