"""The Gaussian kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

from jaxtyping import Float

from common.kernels.kernel import Array, Parameters, Property, RadialKernel


@final
@dataclass(frozen=True)
class Gaussian(RadialKernel):
    """K(x, y) = exp(-|x - y|^2 / bandwidth), with bandwidth = sigma^2 (paper, section 3.1). Positive definite."""

    bandwidth: float

    name: ClassVar[str] = "gaussian"
    properties: ClassVar[frozenset[Property]] = frozenset({"positive semi-definite", "spectrum", "orthonormal basis"})

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> Gaussian:
        return cls(parameters.bandwidth)

    def of_squared_distance(self, squared: Float[Array, "*batch"], xp: Any) -> Float[Array, "*batch"]:
        return xp.exp(-squared / self.bandwidth)

    def distance(self, squared: Float[Array, "*batch"], xp: Any) -> Float[Array, "*batch"]:
        return squared

    def frequency_scale(self, u: Float[Array, "F 1"], error: float, xp: Any) -> float:
        """The spectrum is N(0, 2/bandwidth I)."""
        return (2.0 / self.bandwidth) ** 0.5
