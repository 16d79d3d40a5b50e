"""A kernel as a mathematical object: its formula and what is known of it, apart from how a Gram matrix is computed.

Formulas are written in the functions of an array namespace `xp`: `jax.numpy` in a run; NumPy will do, too.
"""

from __future__ import annotations

import abc
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

from jaxtyping import Float

Array = Any
"""An array of the namespace `xp`."""

Property = Literal["positive semi-definite", "spectrum", "orthonormal basis"]
"""Properties that a representation of h may need of its kernel.

spectrum: K is the characteristic function of a distribution, so that there are random Fourier features.
orthonormal basis: the one of `common.maths.rkhs.basis` spans the kernel's space.
"""


@runtime_checkable
class Parameters(Protocol):
    """The settings that kernels take their parameters from (`common.config.rkhs.RkhsSettings`)."""

    @property
    def bandwidth(self) -> float: ...

    @property
    def slope(self) -> float: ...

    @property
    def offset(self) -> float: ...


class Kernel(abc.ABC):
    """K(x, y) as a function of <x, y>, |x|^2 and |y|^2, so that a Gram matrix costs one matrix product.

    Concrete kernels are frozen dataclasses, hence hashable: a compiled function can hold one as a constant.
    """

    name: ClassVar[str]
    properties: ClassVar[frozenset[Property]]

    @classmethod
    @abc.abstractmethod
    def from_parameters(cls, parameters: Parameters) -> Kernel:
        """The kernel of a run's settings."""

    @abc.abstractmethod
    def of(
        self, products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"], xp: Any
    ) -> Float[Array, "B M"]:
        """K(x_i, y_j) for all pairs, from <x_i, y_j>, |x_i|^2 and |y_j|^2."""


class RadialKernel(Kernel):
    """A kernel of the distance |x - y| with a bandwidth; its spectrum is a scale mixture of Gaussians.

    Every positive definite function of the distance in spaces of all dimensions is one (Schoenberg 1938).
    """

    bandwidth: float

    @abc.abstractmethod
    def of_squared_distance(self, squared: Float[Array, "*batch"], xp: Any) -> Float[Array, "*batch"]:
        """K from |x - y|^2."""

    @abc.abstractmethod
    def distance(self, squared: Float[Array, "*batch"], xp: Any) -> Float[Array, "*batch"]:
        """The power of |x - y|, from |x - y|^2, that the formula divides by the bandwidth."""

    @abc.abstractmethod
    def frequency_scale(self, u: Float[Array, "F 1"], error: float, xp: Any) -> float | Float[Array, "F 1"]:
        """s such that frequencies s g with g ~ N(0, I) have the kernel's spectrum: E[cos(s g (x - y))] = K(x, y).

        Args:
            u: standard normal numbers that s may depend on.
            error: how far that expectation may be from K, for kernels whose spectrum has no moments.
        """

    def of(
        self, products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"], xp: Any
    ) -> Float[Array, "B M"]:
        # Rounding can make the distance of a point to itself slightly negative, and K greater than 1.
        return self.of_squared_distance(xp.maximum(x_squared + y_squared - 2.0 * products, 0.0), xp)
