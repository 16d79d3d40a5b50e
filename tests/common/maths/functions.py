"""Points, coefficients and functional steps that tests of the representations share."""

from __future__ import annotations

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from common.maths.rkhs.representation import Representation


def points(count: int, size: int, seed: int = 0) -> np.ndarray:
    """Standard normal points, in float64."""
    return np.random.default_rng(seed).normal(size=(count, size))


def as_dtype(tree: Any, dtype: Any) -> Any:
    """The tree with its floating-point arrays in another precision."""
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, tree)


def stepped(
    representation: Representation[Any, Any],
    state: tuple[Any, Any],
    features: Any,
    coefficients: Any,
    *,
    decay: float = 0.0,
    landmarks: Any = None,
) -> tuple[Any, Any]:
    """h and v after one step of size 1 in the state's own precision, compiled as one program."""
    dtype = state[0].weights.dtype
    z, alpha = jnp.asarray(features, dtype), jnp.asarray(coefficients, dtype)
    pool = z if landmarks is None else jnp.asarray(landmarks, dtype)
    return _step(representation, decay)(*state, z, alpha, pool)


@cache
def _step(representation: Representation[Any, Any], decay: float) -> Any:
    @jax.jit
    def step(function: Any, state: Any, z: Array, alpha: Array, pool: Array) -> tuple[Any, Any]:
        function, state = representation.average(function, state, z, alpha, lambda k: pool[:k], decay=decay)
        return representation.apply(function, state, 1.0, shrinkage=0.0), state

    return step


def value(representation: Representation[Any, Any], function: Any, at: np.ndarray) -> np.ndarray:
    """h at points."""
    return np.asarray(_evaluate(representation)(function, jnp.asarray(at, function.weights.dtype)))


@cache
def _evaluate(representation: Representation[Any, Any]) -> Any:
    return jax.jit(representation.evaluate)


def gaussian_sum(centres: np.ndarray, weights: np.ndarray, at: np.ndarray, bandwidth: float) -> np.ndarray:
    """sum_i w_i exp(-|c_i - x|^2 / bandwidth) in NumPy."""
    squared = np.sum((at[:, None, :] - centres[None, :, :]) ** 2, axis=2)
    return np.exp(-squared / bandwidth) @ weights


def rkhs_norm(centres: np.ndarray, weights: np.ndarray, bandwidth: float) -> float:
    """|sum_i w_i K(c_i, .)| for the Gaussian kernel, over all columns."""
    return float(np.sqrt(max(0.0, np.sum(weights * gaussian_sum(centres, weights, centres, bandwidth)))))
