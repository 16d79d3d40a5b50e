"""Every transition of a gradient becomes a centre, as in the paper; within a budget, the oldest are evicted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from common.maths import expansion as expansions
from common.maths.expansion import Expansion, RepresentationState
from common.maths.rkhs.representation import OfKernels, SampleFeatures


@final
@dataclass(frozen=True)
class Exact(OfKernels[RepresentationState]):
    """h as the paper has it. `capacity` is the budget; n must be within it.

    The oldest centre goes, not the one with the smallest weight: features move on while psi is trained, and old
    centres are where features no longer are (docs/decisions/0010-evict-the-oldest-centre.md).
    """

    def empty(self, feature_size: int, action_size: int) -> tuple[Expansion, RepresentationState]:
        return expansions.empty(self.capacity, feature_size, action_size)

    def average(
        self,
        function: Expansion,
        state: RepresentationState,
        features: Float[Array, "n d"],
        coefficients: Float[Array, "n A"],
        sample_features: SampleFeatures,
        *,
        decay: float,
    ) -> tuple[Expansion, RepresentationState]:
        return expansions.append(function, state, features, coefficients, decay=decay)

    def size(self, function: Expansion, state: RepresentationState) -> Int[Array, ""]:
        return expansions.size(function, state)

    def age(self, state: RepresentationState, samples: int) -> Float[Array, ""]:
        rows = jnp.arange(state.velocity.shape[0], dtype=jnp.int32)
        used = rows < state.added  # numbered by age, newest first
        return jnp.sum(jnp.where(used, rows // samples, 0)) / jnp.maximum(jnp.sum(used), 1)
