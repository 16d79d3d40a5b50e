"""Online clustering of centres (Wang and Principe 2021): a transition near a centre adds to that centre's weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from common.maths.expansion import Expansion, RepresentationState
from common.maths.gram import gram, squared_distances
from common.maths.rkhs.representation import OfKernels, SampleFeatures


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ClusterState(RepresentationState):
    """`born`: the update at which each row's centre was added; `updates`: updates since the start."""

    born: Int[Array, "M"]
    updates: Int[Array, ""]


@final
@dataclass(frozen=True)
class Cluster(OfKernels[ClusterState]):
    """A transition closer than `radius` to a centre joins the nearest one; the others are visited in order.

    Each of those becomes a centre, and what is closer to it than `radius` and not yet taken joins it. With radius 0
    nothing joins, and this is `exact`. For a kernel with Lipschitz constant L a step errs by at most
    radius L sum_k |alpha_k| anywhere. Where there are more clusters than room in one step, the rest joins the nearest.
    A full expansion evicts its oldest centres.
    """

    radius: float

    def empty(self, feature_size: int, action_size: int) -> tuple[Expansion, ClusterState]:
        weights = jnp.zeros((self.capacity, action_size), jnp.float32)
        centres = jnp.zeros((self.capacity, feature_size), jnp.float32)
        zero = jnp.zeros((), jnp.int32)
        return Expansion(centres, weights), ClusterState(weights, zero, jnp.zeros((self.capacity,), jnp.int32), zero)

    def average(
        self,
        function: Expansion,
        state: ClusterState,
        features: Float[Array, "n d"],
        coefficients: Float[Array, "n A"],
        sample_features: SampleFeatures,
        *,
        decay: float,
    ) -> tuple[Expansion, ClusterState]:
        capacity, room = function.capacity, min(features.shape[0], function.capacity)
        used = jnp.arange(capacity, dtype=jnp.int32) < state.added
        distance = jnp.where(used[None, :], squared_distances(features, function.centres), jnp.inf)
        nearest = jnp.argmin(distance, axis=1).astype(jnp.int32)
        joined = jnp.min(distance, axis=1) < self.radius**2
        leaders, owner = self._lead(features, joined, room)
        count = jnp.sum(leaders < features.shape[0], dtype=jnp.int32)
        # Shapes are fixed, the number of new centres is not: row numbers past `count` are out of bounds, and writes to
        # them dropped. New centres take the rows after the newest one, so that rows are overwritten oldest first.
        order = jnp.arange(room, dtype=jnp.int32)
        rows = jnp.where(order < count, (state.added + order) % capacity, capacity)
        kept = jnp.ones((capacity, 1), state.velocity.dtype).at[rows].set(0.0, mode="drop")
        # A transition that joined a centre evicted in this very step is lost with it: the row now holds another centre.
        old = jnp.where(kept[nearest, 0] > 0.0, nearest, capacity)
        target = jnp.where(owner < room, rows[jnp.minimum(owner, room - 1)], old)
        velocity = (decay * kept * state.velocity).at[target].add((1.0 - decay) * coefficients, mode="drop")
        centres = function.centres.at[rows].set(features[jnp.minimum(leaders, features.shape[0] - 1)], mode="drop")
        born = state.born.at[rows].set(state.updates, mode="drop")
        added = state.added + count
        return Expansion(centres, kept * function.weights), ClusterState(velocity, added, born, state.updates + 1)

    def _lead(
        self, features: Float[Array, "n d"], joined: Bool[Array, "n"], room: int
    ) -> tuple[Int[Array, "room"], Int[Array, "n"]]:
        """The transitions that become centres, in order, and for every transition the number of its new centre.

        Numbers past the last new centre are n among the first, and `room` among the second: there the transition joins
        an old centre. One round for each new centre, of n distances.
        """
        count = features.shape[0]
        # `owner` is the number of a transition's new centre, `room` where it has joined an old one, and -1 while it is
        # not assigned. Sequential by nature: whether a transition leads depends on the radii of all leaders before it.

        def unassigned_left(carry: tuple[Array, Array, Array]) -> Array:
            made, _, owner = carry
            return (made < room) & jnp.any(owner < 0)

        def lead(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            made, leaders, owner = carry
            leader = jnp.argmax(owner < 0).astype(jnp.int32)
            distance = jnp.sum(jnp.square(features - features[leader]), axis=1)
            takes = (owner < 0) & (distance < self.radius**2)
            # A leader owns itself even with radius 0, or the loop would not end.
            owner = jnp.where(takes, made, owner).at[leader].set(made)
            return made + 1, leaders.at[made].set(leader), owner

        start = (
            jnp.zeros((), jnp.int32),
            jnp.full((room,), count, jnp.int32),
            jnp.where(joined, room, -1).astype(jnp.int32),
        )
        _, leaders, owner = jax.lax.while_loop(unassigned_left, lead, start)
        if count > room:  # more clusters than room are possible: the rest joins the nearest, whatever its distance
            nearest = jnp.argmin(squared_distances(features, features[jnp.minimum(leaders, count - 1)]), axis=1)
            owner = jnp.where(owner < 0, nearest.astype(jnp.int32), owner)
        return leaders, owner

    def gradient_gram(
        self, function: Expansion, state: ClusterState, features: Float[Array, "G d"], samples: int
    ) -> Float[Array, "G G"]:
        used = jnp.arange(function.capacity, dtype=jnp.int32) < state.added
        distance = jnp.where(used[None, :], squared_distances(features, function.centres), jnp.inf)
        joined = (jnp.min(distance, axis=1) < self.radius**2)[:, None]
        stand_ins = jnp.where(joined, function.centres[jnp.argmin(distance, axis=1)], features)
        return gram(self.kernel, stand_ins, stand_ins)

    def size(self, function: Expansion, state: ClusterState) -> Int[Array, ""]:
        return jnp.minimum(state.added, function.capacity)

    def age(self, state: ClusterState, samples: int) -> Float[Array, ""]:
        return mean_age(state, jnp.arange(state.born.shape[0], dtype=jnp.int32) < state.added)


def mean_age(state: ClusterState, used: Bool[Array, "M"]) -> Float[Array, ""]:
    """Mean number of updates since the used rows were added, 0 for those of the last update."""
    total = jnp.sum(jnp.where(used, state.updates - 1 - state.born, 0))
    return total / jnp.maximum(jnp.sum(used), 1)
