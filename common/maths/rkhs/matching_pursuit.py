"""Kernel matching pursuit (Vincent and Bengio 2002; Le et al. 2019): few centres, chosen, refitted by projection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from common.maths.expansion import Expansion
from common.maths.gram import diagonal, gram, product
from common.maths.rkhs.clustering import ClusterState, mean_age
from common.maths.rkhs.nystrom import inverse_root
from common.maths.rkhs.representation import OfKernels, SampleFeatures

ADMITTED = 16
"""At most capacity / ADMITTED transitions of a step become centres; the gradient of the rest is projected."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PursuitState(ClusterState):
    """`used`: rows that hold a centre; `error`: bound on the RKHS distance the last step's pruning moved h."""

    used: Bool[Array, "M"]
    error: Float[Array, ""]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Pruning:
    """The dictionary while centres are taken out: the inverse Gram matrix of those left, and the error so far."""

    inverse: Float[Array, "M M"]
    targets: Float[Array, "M C"]
    used: Bool[Array, "M"]
    spent: Float[Array, ""]


@final
@dataclass(frozen=True)
class KernelMatchingPursuit(OfKernels[PursuitState]):
    """Before a step, centres are taken out until there is room, and while that costs at most `error` in all.

    Taking out centre j and refitting the others by projection moves h by |w_j| / sqrt(H_jj) in the RKHS, with H the
    inverse Gram matrix; the one that costs least goes first. h and v are refitted together: the cost is that of both,
    v weighted by what it will still add to h, so that a new centre is not judged by its first tenth. The sum of the
    costs is kept: h is never further than that from what it was, and never further than `error` unless room was needed.

    Of n transitions the capacity / 16 that the centres stand in for worst become centres; the gradient of all is
    projected onto the span. The cost is linear in n; a step inverts Gram matrices of M centres.
    """

    error: float

    def empty(self, feature_size: int, action_size: int) -> tuple[Expansion, PursuitState]:
        m = self.capacity
        weights = jnp.zeros((m, action_size), jnp.float32)
        zero = jnp.zeros((), jnp.int32)
        used = jnp.zeros((m,), jnp.bool_)
        state = PursuitState(weights, zero, jnp.zeros((m,), jnp.int32), zero, used, jnp.zeros((), jnp.float32))
        return Expansion(jnp.zeros((m, feature_size), jnp.float32), weights), state

    def admitted(self, samples: int) -> int:
        """New centres of a step."""
        return min(samples, max(1, self.capacity // ADMITTED))

    def average(
        self,
        function: Expansion,
        state: PursuitState,
        features: Float[Array, "n d"],
        coefficients: Float[Array, "n A"],
        sample_features: SampleFeatures,
        *,
        decay: float,
    ) -> tuple[Expansion, PursuitState]:
        count = features.shape[0]
        wanted = self.admitted(count)
        function, state = self._make_room(function, state, wanted, decay)
        chosen = jnp.arange(count, dtype=jnp.int32)
        if wanted < count:
            chosen = self._worst(function, state.used, features, coefficients, wanted)
        rows = jnp.nonzero(~state.used, size=wanted)[0].astype(jnp.int32)
        used = state.used.at[rows].set(True)
        function = Expansion(function.centres.at[rows].set(features[chosen]), function.weights)
        gradient = jnp.zeros_like(state.velocity).at[rows].add(coefficients[chosen])
        if wanted < count:
            # More transitions than new centres: the gradient's projection onto the span, in place of its own terms.
            inverse = self._inverse(function.centres, used)
            across = product(gram(self.kernel, function.centres, features), coefficients)
            gradient = product(inverse, jnp.where(used[:, None], across, 0.0))
        return function, PursuitState(
            velocity=decay * state.velocity + (1.0 - decay) * gradient,
            added=state.added + wanted,
            born=state.born.at[rows].set(state.updates),
            updates=state.updates + 1,
            used=used,
            error=state.error,
        )

    def gradient_gram(
        self, function: Expansion, state: PursuitState, features: Float[Array, "G d"], samples: int
    ) -> Float[Array, "G G"]:
        if self.admitted(samples) == samples:
            return gram(self.kernel, features, features)
        across = jnp.where(state.used[None, :], gram(self.kernel, features, function.centres), 0.0)
        return product(product(across, self._inverse(function.centres, state.used)), across.T)

    def size(self, function: Expansion, state: PursuitState) -> Int[Array, ""]:
        return jnp.sum(state.used, dtype=jnp.int32)

    def age(self, state: PursuitState, samples: int) -> Float[Array, ""]:
        return mean_age(state, state.used)

    def figures(self, state: PursuitState) -> dict[str, Array]:
        return {"pruning_error": state.error}

    def _make_room(
        self, function: Expansion, state: PursuitState, wanted: int, decay: float
    ) -> tuple[Expansion, PursuitState]:
        """Take out centres until `wanted` rows are free, and while the error allows."""
        size = function.weights.shape[1]
        # Without new gradients v adds decay + decay^2 + ... = decay / (1 - decay) of itself to h. Counted now, or a new
        # centre would be the cheapest one: its weight starts with a tenth of its coefficient.
        ahead = decay / (1.0 - decay)

        def prune(_: None) -> _Pruning:
            # One inversion for all removals: without row j the inverse of the rest is a rank-one correction away.
            inverse = self._inverse(function.centres, state.used)
            targets = jnp.concatenate([function.weights, ahead * state.velocity], axis=1)
            return jax.lax.while_loop(
                lambda pruning: self._worth(pruning, wanted),
                _take_out,
                _Pruning(inverse, targets, state.used, jnp.zeros((), inverse.dtype)),
            )

        def leave(_: None) -> _Pruning:
            pruning = jax.eval_shape(prune, None)
            nothing = jnp.zeros(pruning.inverse.shape, pruning.inverse.dtype)
            targets = jnp.concatenate([function.weights, ahead * state.velocity], axis=1)
            return _Pruning(nothing, targets, state.used, jnp.zeros((), nothing.dtype))

        # The inverse costs M^3, so it is left out while there is room; with an error to spend there is always work.
        full = jnp.sum(~state.used) < wanted
        pruned = prune(None) if self.error else jax.lax.cond(full, prune, leave, None)
        weights = jnp.where(pruned.used[:, None], pruned.targets[:, :size], 0.0)
        velocity = state.velocity
        if ahead:  # without momentum v is the last gradient and already in h: nothing to refit
            velocity = jnp.where(pruned.used[:, None], pruned.targets[:, size:] / ahead, 0.0)
        return Expansion(function.centres, weights), PursuitState(
            velocity, state.added, state.born, state.updates, pruned.used, pruned.spent.astype(jnp.float32)
        )

    def _worth(self, pruning: _Pruning, wanted: int) -> Bool[Array, ""]:
        cheapest = jnp.min(costs(pruning.inverse, pruning.targets, pruning.used))
        affordable = pruning.spent + cheapest <= self.error if self.error else jnp.zeros((), jnp.bool_)
        return (jnp.sum(~pruning.used) < wanted) | (affordable & jnp.any(pruning.used))

    def _worst(
        self,
        function: Expansion,
        used: Bool[Array, "M"],
        features: Float[Array, "n d"],
        coefficients: Float[Array, "n A"],
        wanted: int,
    ) -> Int[Array, "wanted"]:
        """The transitions whose part of the gradient is furthest from the span of the centres."""
        across = jnp.where(used[None, :], gram(self.kernel, features, function.centres), 0.0)
        explained = jnp.sum(product(across, self._inverse(function.centres, used)) * across, axis=1)
        left = jnp.maximum(diagonal(self.kernel, features) - explained, 0.0)
        return jax.lax.top_k(left * jnp.sum(jnp.square(coefficients), axis=1), wanted)[1].astype(jnp.int32)

    def _inverse(self, centres: Float[Array, "M d"], used: Bool[Array, "M"]) -> Float[Array, "M M"]:
        """The inverse Gram matrix of the used centres, and of the identity elsewhere.

        Of the Gram matrix plus the jitter of `inverse_root`: costs computed from it are not less than the true ones.
        """
        both = used[:, None] & used[None, :]
        matrix = jnp.where(both, gram(self.kernel, centres, centres), jnp.eye(centres.shape[0], dtype=centres.dtype))
        root = inverse_root(matrix)
        return product(root, root)


def costs(inverse: Float[Array, "M M"], targets: Float[Array, "M C"], used: Bool[Array, "M"]) -> Float[Array, "M"]:
    """The RKHS distance that taking out each centre moves all columns' functions by; infinite where there is none."""
    squares = jnp.sum(jnp.square(targets), axis=1)
    tiny = jnp.finfo(inverse.dtype).tiny
    return jnp.where(used, jnp.sqrt(squares / jnp.maximum(jnp.diagonal(inverse), tiny)), jnp.inf)


def _take_out(pruning: _Pruning) -> _Pruning:
    """Without the cheapest centre: the targets projected onto the span of the rest, the inverse that of the rest."""
    cost = costs(pruning.inverse, pruning.targets, pruning.used)
    j = jnp.argmin(cost)
    column = pruning.inverse[:, j] / jnp.maximum(pruning.inverse[j, j], jnp.finfo(pruning.inverse.dtype).tiny)
    targets = pruning.targets - column[:, None] * pruning.targets[j][None, :]
    inverse = pruning.inverse - column[:, None] * pruning.inverse[j][None, :]
    return _Pruning(inverse, targets.at[j].set(0.0), pruning.used.at[j].set(False), pruning.spent + cost[j])
