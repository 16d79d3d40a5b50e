"""h as a sum over centres, sum_i w_i K(c_i, .): centres frozen when added, weights that move.

The arrays have their full capacity M from the start, so growth neither recompiles nor reallocates. A row not
used yet has weight zero, which makes its kernel value irrelevant.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from common.kernels import Kernel
from common.maths.gram import gram


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Expansion:
    """A function of the RKHS with values in R^A: what acting needs."""

    centres: Float[Array, "M d"]
    weights: Float[Array, "M A"]

    @property
    def capacity(self) -> int:
        return self.centres.shape[0]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RepresentationState:
    """State of a representation of h from one update to the next, beside h itself.

    Subclasses add what their representation needs: the age of centres, the whitening of landmarks.

    velocity: the moving average of the functional gradient, in the coefficients of h.
    added: centres added since the start; for representations that add none, updates since the start.
    """

    velocity: Float[Array, "M A"]
    added: Int[Array, ""]


def empty(capacity: int, feature_size: int, action_size: int) -> tuple[Expansion, RepresentationState]:
    """h = 0, with room for `capacity` centres."""
    weights = jnp.zeros((capacity, action_size), jnp.float32)
    centres = jnp.zeros((capacity, feature_size), jnp.float32)
    return Expansion(centres, weights), RepresentationState(weights, jnp.zeros((), jnp.int32))


def size(expansion: Expansion, state: RepresentationState) -> Int[Array, ""]:
    """Centres in use."""
    return jnp.minimum(state.added, expansion.capacity)


def evaluate(expansion: Expansion, kernel: Kernel, features: Float[Array, "B d"]) -> Float[Array, "B A"]:
    """h at the features, already scaled for the kernel."""
    return gram(kernel, features, expansion.centres) @ expansion.weights


def append(
    expansion: Expansion,
    state: RepresentationState,
    features: Float[Array, "n d"],
    coefficients: Float[Array, "n A"],
    *,
    decay: float,
) -> tuple[Expansion, RepresentationState]:
    """Take n centres in, with weight 0, and g = sum_k alpha_k K(c_k, .) into v <- decay v + (1 - decay) g.

    The newest centre stands in row (added - 1) mod M. A full expansion evicts its oldest centres, with what
    they contributed to h and v.

    Args:
        features: the new centres c_k.
        coefficients: alpha_k.
    """
    rows = (state.added + jnp.arange(features.shape[0], dtype=jnp.int32)) % expansion.capacity
    centres = expansion.centres.at[rows].set(features)
    velocity = decay * state.velocity.at[rows].set(0.0)
    velocity = velocity.at[rows].add((1.0 - decay) * coefficients)
    weights = expansion.weights.at[rows].set(0.0)
    return Expansion(centres, weights), RepresentationState(velocity, state.added + features.shape[0])


def step(
    expansion: Expansion,
    state: RepresentationState,
    features: Float[Array, "n d"],
    coefficients: Float[Array, "n A"],
    *,
    decay: float,
) -> tuple[Expansion, RepresentationState]:
    """The functional gradient step with a fixed size, h <- h + v (paper, equation 8 and Table 1's "Adam for RKHS").

    Arguments as in `append`; the coefficients include the step size.
    """
    expansion, state = append(expansion, state, features, coefficients, decay=decay)
    return Expansion(expansion.centres, expansion.weights + state.velocity), state
