"""The interface of the representations of h, and the arrays of h."""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from common.kernels import Kernel
from common.maths.expansion import Expansion, RepresentationState
from common.maths.gram import gram, product


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Embedding:
    """h = phi(.) @ weights for finitely many functions phi that are orthonormal, or taken to be.

    directions: what phi is made from; drawn once, never changed.
    """

    directions: Float[Array, "F d"]
    weights: Float[Array, "M A"]

    @property
    def capacity(self) -> int:
        return self.weights.shape[0]


_BLOCK = 4096

Function = Expansion | Embedding
FunctionT = TypeVar("FunctionT", Expansion, Embedding)
StateT = TypeVar("StateT", bound=RepresentationState)

SampleFeatures = Callable[[int], Float[Array, "k d"]]
"""Features of so many transitions, spread evenly over the batch."""


@dataclass(frozen=True)
class Representation(abc.ABC, Generic[FunctionT, StateT]):
    """h = sum_i w_i e_i for M functions e_i of the RKHS; what these are, and how a gradient becomes one of their sums.

    A functional step is two calls: `average` takes the gradient into its moving average v, itself a sum of the same
    functions; `apply` moves h along v by a step size found meanwhile. Shapes are fixed: nothing is compiled twice.
    """

    kernel: Kernel
    capacity: int

    @abc.abstractmethod
    def empty(self, feature_size: int, action_size: int) -> tuple[FunctionT, StateT]:
        """h = 0 and v = 0."""

    @abc.abstractmethod
    def activations(self, function: FunctionT, features: Float[Array, "B d"]) -> Float[Array, "B M"]:
        """e_i at the features, already scaled for the kernel."""

    @abc.abstractmethod
    def inner(self, function: FunctionT, weights: Float[Array, "M A"]) -> Float[Array, "M A"]:
        """<e_i, sum_j w_j e_j>: the Gram matrix of the e_i times weights."""

    @abc.abstractmethod
    def average(
        self,
        function: FunctionT,
        state: StateT,
        features: Float[Array, "n d"],
        coefficients: Float[Array, "n A"],
        sample_features: SampleFeatures,
        *,
        decay: float,
    ) -> tuple[FunctionT, StateT]:
        """v <- decay v + (1 - decay) g for the gradient g = sum_k alpha_k K(z_k, .).

        h stays as it is but for what is given up to make room.

        Args:
            features, coefficients: z_k and alpha_k.
        """

    @abc.abstractmethod
    def size(self, function: FunctionT, state: StateT) -> Int[Array, ""]:
        """Functions e_i in use."""

    @abc.abstractmethod
    def age(self, state: StateT, samples: int) -> Float[Array, ""]:
        """Mean number of updates that the e_i in use have been in use, at `samples` transitions an update."""

    def figures(self, state: StateT) -> dict[str, Array]:
        """Metrics that only this representation has, by name."""
        return {}

    def evaluate(self, function: FunctionT, features: Float[Array, "B d"]) -> Float[Array, "B A"]:
        """h at the features."""
        return self.activations(function, features) @ function.weights

    def velocity(self, function: FunctionT, state: StateT, features: Float[Array, "B d"]) -> Float[Array, "B A"]:
        """v at the features."""
        return self.activations(function, features) @ state.velocity

    def apply(
        self, function: FunctionT, state: StateT, scale: float | Float[Array, ""], *, shrinkage: float
    ) -> FunctionT:
        """h <- (1 - shrinkage) h + scale v."""
        kept = function.weights if shrinkage == 0.0 else (1.0 - shrinkage) * function.weights
        return replace(function, weights=kept + scale * state.velocity)

    @abc.abstractmethod
    def gradient_gram(
        self, function: FunctionT, state: StateT, features: Float[Array, "G d"], samples: int
    ) -> Float[Array, "G G"]:
        """<g_i, g_j> of the functions that this representation takes K(z_i, .) for, in gradients of `samples`."""

    def retreat(
        self, old: tuple[FunctionT, StateT], averaged: tuple[FunctionT, StateT], part: Float[Array, ""]
    ) -> tuple[FunctionT, StateT]:
        """h and v with the functions of `old`, for an update in which `averaged` changes h by too much.

        Only this part of that change is made. The gradient of the update is lost: there is no room for it yet.
        """
        weights = old[0].weights + part * (self.surviving_weights(old[0], averaged[0]) - old[0].weights)
        return replace(old[0], weights=weights), old[1]

    def surviving_weights(self, old: FunctionT, averaged: FunctionT) -> Float[Array, "M A"]:
        """The weights with which the functions of `old` are the h of `averaged`."""
        return averaged.weights

    def norm(self, function: FunctionT) -> Float[Array, ""]:
        """|h| in the RKHS. Where the kernel is not positive semi-definite a negative square counts as 0."""
        square = jnp.sum(function.weights * self.inner(function, function.weights))
        return jnp.sqrt(jnp.maximum(square, 0.0))


class OfKernels(Representation[Expansion, StateT]):
    """The functions are K(c_i, .)."""

    def surviving_weights(self, old: Expansion, averaged: Expansion) -> Float[Array, "M A"]:
        # A new centre has weight 0 so far; the one that its row held before is evicted.
        stayed = jnp.all(old.centres == averaged.centres, axis=1, keepdims=True)
        return jnp.where(stayed, averaged.weights, 0.0)

    def activations(self, function: Expansion, features: Float[Array, "B d"]) -> Float[Array, "B M"]:
        return gram(self.kernel, features, function.centres)

    def gradient_gram(
        self, function: Expansion, state: StateT, features: Float[Array, "G d"], samples: int
    ) -> Float[Array, "G G"]:
        return gram(self.kernel, features, features)

    def inner(self, function: Expansion, weights: Float[Array, "M A"]) -> Float[Array, "M A"]:
        def of_centre(centre: Float[Array, "d"]) -> Float[Array, "A"]:
            return (gram(self.kernel, centre[None], function.centres) @ weights)[0]

        if self.capacity <= _BLOCK:
            return gram(self.kernel, function.centres, function.centres) @ weights
        return jax.lax.map(of_centre, function.centres, batch_size=_BLOCK)  # a whole Gram matrix might not fit


class OfFeatures(Representation[Embedding, RepresentationState]):
    """The functions are finitely many orthonormal ones; K(x, y) is close to phi(x) @ phi(y)."""

    def gradient_gram(
        self, function: Embedding, state: RepresentationState, features: Float[Array, "G d"], samples: int
    ) -> Float[Array, "G G"]:
        phi = self.activations(function, features)
        return product(phi, phi.T)

    def inner(self, function: Embedding, weights: Float[Array, "M A"]) -> Float[Array, "M A"]:
        return weights

    def average(
        self,
        function: Embedding,
        state: RepresentationState,
        features: Float[Array, "n d"],
        coefficients: Float[Array, "n A"],
        sample_features: SampleFeatures,
        *,
        decay: float,
    ) -> tuple[Embedding, RepresentationState]:
        gradient = self.activations(function, features).T @ coefficients
        velocity = decay * state.velocity + (1.0 - decay) * gradient
        return function, RepresentationState(velocity, state.added + 1)

    def size(self, function: Embedding, state: RepresentationState) -> Int[Array, ""]:
        return jnp.full((), function.capacity, jnp.int32)

    def age(self, state: RepresentationState, samples: int) -> Float[Array, ""]:
        return state.added.astype(jnp.float32)
