"""The finitely many functions phi of which the kernel critic's g = phi @ weights is a sum."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from common.config.critic import CriticSettings
from common.kernels.gaussian import Gaussian
from common.maths.gram import gram, product
from common.maths.rkhs.fourier import frequencies
from common.maths.rkhs.nystrom import inverse_root
from common.maths.samples import evenly_spread_rows
from common.maths.trigonometry import cos_sin


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Points:
    """Arrays that phi is made from.

    directions: frequencies, landmarks, or none.
    whitening: K_LL^-1/2 of landmarks; empty elsewhere.
    """

    directions: Float[Array, "F d"]
    whitening: Float[Array, "W W"]


@dataclass(frozen=True)
class Functions(abc.ABC):
    """phi: R^d -> R^size, orthonormal in the RKHS of the kernel, so that |weights| is the norm of g."""

    inputs: int

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """M, the number of functions."""

    @abc.abstractmethod
    def start(self) -> Points:
        """The points before the first batch."""

    def renew(self, points: Points, inputs: Float[Array, "B d"]) -> Points:
        """The points for a fit on these inputs."""
        return points

    @abc.abstractmethod
    def __call__(self, points: Points, inputs: Float[Array, "B d"]) -> Float[Array, "B M"]:
        """phi at the inputs."""


@final
@dataclass(frozen=True)
class Linear(Functions):
    """phi(x) = (x, 1): the control that a kernel has to beat."""

    @property
    def size(self) -> int:
        return self.inputs + 1

    def start(self) -> Points:
        return _points(0, self.inputs)

    def __call__(self, points: Points, inputs: Float[Array, "B d"]) -> Float[Array, "B M"]:
        return jnp.concatenate([inputs, jnp.ones_like(inputs[:, :1])], axis=1)


@final
@dataclass(frozen=True)
class Fourier(Functions):
    """Cosines and sines of random frequencies; phi(x) @ phi(y) is close to exp(-|x - y|^2 / bandwidth)."""

    capacity: int
    bandwidth: float
    seed: int

    @property
    def size(self) -> int:
        return self.capacity

    def start(self) -> Points:
        key = jax.random.fold_in(jax.random.key(self.seed), 0xC717)
        directions = frequencies(Gaussian(self.bandwidth), key, self.capacity // 2, self.inputs)
        return Points(directions, jnp.zeros((0, 0), jnp.float32))

    def __call__(self, points: Points, inputs: Float[Array, "B d"]) -> Float[Array, "B M"]:
        cosine, sine = cos_sin(product(inputs, points.directions.T))
        return jnp.concatenate([cosine, sine], axis=1) * (points.directions.shape[0] ** -0.5)


@final
@dataclass(frozen=True)
class Landmarks(Functions):
    """phi(x) = K_LL^-1/2 K(L, x) for landmarks L spread evenly over the newest batch."""

    capacity: int
    bandwidth: float

    @property
    def size(self) -> int:
        return self.capacity

    def start(self) -> Points:
        return _points(self.capacity, self.inputs, whitening=self.capacity)

    def renew(self, points: Points, inputs: Float[Array, "B d"]) -> Points:
        landmarks = inputs[evenly_spread_rows(inputs.shape[0], self.capacity)]
        return Points(landmarks, inverse_root(gram(Gaussian(self.bandwidth), landmarks, landmarks)))

    def __call__(self, points: Points, inputs: Float[Array, "B d"]) -> Float[Array, "B M"]:
        return product(gram(Gaussian(self.bandwidth), inputs, points.directions), points.whitening)


def _points(count: int, inputs: int, whitening: int = 0) -> Points:
    return Points(jnp.zeros((count, inputs), jnp.float32), jnp.zeros((whitening, whitening), jnp.float32))


def make_functions(settings: CriticSettings, inputs: int, seed: int) -> Functions:
    """The functions that the settings name, of so many inputs. `none` is not among them."""
    if settings.representation == "rff":
        return Fourier(inputs, settings.capacity, settings.bandwidth, seed)
    if settings.representation == "nystrom":
        return Landmarks(inputs, settings.capacity, settings.bandwidth)
    return Linear(inputs)
