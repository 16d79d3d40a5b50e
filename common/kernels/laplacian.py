"""The Laplacian kernel."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, ClassVar, final

from jaxtyping import Float

from common.kernels.kernel import Array, Parameters, Property, RadialKernel


@final
@dataclass(frozen=True)
class Laplacian(RadialKernel):
    """K(x, y) = exp(-|x - y| / bandwidth), the norm Euclidean (paper, section D.4). Positive definite."""

    bandwidth: float

    name: ClassVar[str] = "laplacian"
    properties: ClassVar[frozenset[Property]] = frozenset({"positive semi-definite", "spectrum"})

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> Laplacian:
        return cls(parameters.bandwidth)

    def of_squared_distance(self, squared: Float[Array, "*batch"], xp: Any) -> Float[Array, "*batch"]:
        return xp.exp(-self.distance(squared, xp) / self.bandwidth)

    def distance(self, squared: Float[Array, "*batch"], xp: Any) -> Float[Array, "*batch"]:
        # The root has no derivative at 0; there K is at its maximum, and 0 is the right one of its subgradients.
        apart = squared > 0.0
        return xp.where(apart, xp.sqrt(xp.where(apart, squared, 1.0)), 0.0)

    def frequency_scale(self, u: Float[Array, "F 1"], error: float, xp: Any) -> Float[Array, "F 1"]:
        """The spectrum is a multivariate Cauchy distribution, its tail bounded.

        For w = g / (|u| bandwidth) with g ~ N(0, I) and u ~ N(0, 1): E[cos(w x)] = E[exp(-r^2 / (2 u^2 bandwidth^2))],
        and 1/u^2 is Levy distributed, whose Laplace transform is E[exp(-t / (2 u^2))] = exp(-sqrt(t)).

        The kernel has a kink at 0, so w has no moments: one draw in a thousand is a hundred times as long as most, and
        the gradient of h would be its alone. |u| is therefore held above the value that it passes with probability
        1 - error, which changes no K(x, y) by more than `error`.
        """
        least = NormalDist().inv_cdf(0.5 + 0.5 * error)
        return 1.0 / (xp.maximum(xp.abs(u), least) * self.bandwidth)
