"""The transitions of a batch as networks and expansion train on them."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

PROBE = 1024
"""Transitions on which metrics and step sizes that cost a forward pass are taken, or up to twice as many."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Samples:
    """Transitions in any order; observations whitened, advantages as the critic gives them."""

    obs: Float[Array, "*batch O"]
    action: Float[Array, "*batch A"]
    log_prob: Float[Array, "*batch"]
    value: Float[Array, "*batch"]
    advantage: Float[Array, "*batch"]

    @property
    def target(self) -> Float[Array, "*batch"]:
        """The lambda-return A + V, which the critic learns."""
        return self.advantage + self.value

    def __getitem__(self, rows: slice | Int[Array, "n"]) -> Samples:
        """The transitions of these rows, of the first axis."""
        return jax.tree.map(lambda x: x[rows], self)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pairs:
    """Two transitions from each of M states, under an action and under its mirror image in the mean that acted.

    Their advantages are those of one step: r + gamma V(o') - V(o). M is 0 in a run that does not branch.
    """

    taken: Samples
    mirrored: Samples

    def __getitem__(self, rows: slice | Int[Array, "n"]) -> Pairs:
        return Pairs(self.taken[rows], self.mirrored[rows])


def flatten(x: Array) -> Array:
    """[T, E, ...] as [T * E, ...]."""
    return x.reshape((-1, *x.shape[2:]))


def evenly_spread_rows(count: int, wanted: int) -> Int[Array, "wanted"]:
    """That many row numbers out of `count`, evenly spread."""
    return jnp.arange(wanted, dtype=jnp.int32) * count // wanted


def probe_stride(count: int) -> int:
    """The distance of the rows that metrics are taken on."""
    return max(1, count // PROBE)
