"""Size of a functional step: the largest that keeps the mean KL divergence of all changes of h within a target.

h changes by evicted centres (or their refitting, or new landmarks), by shrinkage, and by the step s v itself. Only the
mean of the policy moves, so that KL is a quadratic function of s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from common.maths import gaussians
from common.maths.expansion import RepresentationState
from common.maths.rkhs.representation import Function, Representation

LARGEST_SCALE = 100.0
"""Bound of s. Where the gradient vanishes at all probes the KL allows any s, and weights of 1e7 with it."""


def largest_scale(
    change: Float[Array, "P A"], velocity: Float[Array, "P A"], log_std: Float[Array, "A"], target: float
) -> Float[Array, ""]:
    """The largest s in [0, LARGEST_SCALE] with a mean KL of `change + s velocity` of at most `target`.

    With KL(s) = a s^2 + b s + c it is the larger root of a s^2 + b s = target - c. Where c alone is above the target it
    is 0, or where the step goes back towards the old h, the s that has a KL of c again.
    """
    precision = jnp.exp(-log_std)
    e, v = change * precision, velocity * precision
    a = 0.5 * jnp.mean(jnp.sum(jnp.square(v), axis=1))
    b = jnp.mean(jnp.sum(e * v, axis=1))
    left = jnp.maximum(target - 0.5 * jnp.mean(jnp.sum(jnp.square(e), axis=1)), 0.0)
    root = jnp.sqrt(jnp.square(b) + 4.0 * a * left)
    tiny = jnp.finfo(root.dtype).tiny
    # Of the two forms of the root the one without a difference of nearly equal numbers.
    scale = jnp.where(b > 0.0, 2.0 * left / jnp.maximum(b + root, tiny), (root - b) / jnp.maximum(2.0 * a, tiny))
    return jnp.minimum(scale, LARGEST_SCALE)


@dataclass(frozen=True)
class TrustRegion:
    """A bound on what an update of h does to the policy, at probes.

    features, h: of the probes, for the networks as they are after their training and h before the update.
    """

    representation: Representation[Any, Any]
    target: float
    features: Float[Array, "P d"]
    h: Float[Array, "P A"]
    log_std: Float[Array, "A"]

    def hold(
        self, old: tuple[Function, RepresentationState], averaged: tuple[Function, RepresentationState]
    ) -> tuple[Function, RepresentationState, Float[Array, ""]]:
        """h and v to step from, and the size s of the step.

        Where the change without a step is above the target by itself, the representation retreats: it makes as much of
        that change as the target allows, and the rest of the update waits.

        Args:
            old: h and v before the update.
            averaged: h and v after `Representation.average`, which adds the gradient to v and may evict centres.
        """
        if averaged[0] is old[0]:  # known at compile time: no centre is ever evicted
            return *averaged, self._scale(averaged, jnp.zeros_like(self.h))
        change = self._change(averaged[0])
        kl = jnp.mean(gaussians.kl_of_means(change, jnp.zeros_like(change), self.log_std))

        def go_on() -> tuple[Any, Any, Array]:
            return *averaged, self._scale(averaged, change)

        def retreat() -> tuple[Any, Any, Array]:
            part = jnp.sqrt(self.target / jnp.maximum(kl, jnp.finfo(kl.dtype).tiny))
            pair = self.representation.retreat(old, averaged, part)
            return *pair, self._scale(pair, self._change(pair[0]))

        return jax.lax.cond(kl <= self.target, go_on, retreat)

    def _change(self, function: Function) -> Float[Array, "P A"]:
        """The change of h at the probes without a step."""
        return self.representation.evaluate(function, self.features) - self.h

    def _scale(self, pair: tuple[Function, RepresentationState], change: Float[Array, "P A"]) -> Float[Array, ""]:
        velocity = self.representation.velocity(*pair, self.features)
        return largest_scale(change, velocity, self.log_std, self.target)
