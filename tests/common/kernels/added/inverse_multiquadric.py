"""A kernel that this project does not have, in one file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from common.kernels.kernel import RadialKernel


@dataclass(frozen=True)
class InverseMultiquadric(RadialKernel):
    """K(x, y) = (1 + |x - y|^2 / bandwidth)^-1/2 = E[exp(-u^2/2 |x - y|^2 / bandwidth)] for u ~ N(0, 1)."""

    bandwidth: float

    name: ClassVar[str] = "inverse-multiquadric"
    properties: ClassVar[frozenset] = frozenset({"positive semi-definite", "spectrum"})

    @classmethod
    def from_parameters(cls, parameters: Any) -> InverseMultiquadric:
        return cls(parameters.bandwidth)

    def of_squared_distance(self, squared: Any, xp: Any) -> Any:
        return 1.0 / xp.sqrt(1.0 + squared / self.bandwidth)

    def distance(self, squared: Any, xp: Any) -> Any:
        return squared

    def frequency_scale(self, u: Any, error: float, xp: Any) -> Any:
        return xp.abs(u) * self.bandwidth**-0.5
