"""The sigmoid kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

from jaxtyping import Float

from common.kernels.kernel import Array, Kernel, Parameters, Property


@final
@dataclass(frozen=True)
class Sigmoid(Kernel):
    """K(x, y) = tanh(slope <x, y> + offset) (paper, section D.4).

    Not positive semi-definite: with slope 1 and offset -1 already K(x, x) < 0 for |x| < 1. There is no RKHS of it; h is
    a function all the same, but norms and projections in the RKHS have no meaning.
    """

    slope: float
    offset: float

    name: ClassVar[str] = "sigmoid"
    properties: ClassVar[frozenset[Property]] = frozenset()

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> Sigmoid:
        return cls(parameters.slope, parameters.offset)

    def of(
        self, products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"], xp: Any
    ) -> Float[Array, "B M"]:
        return xp.tanh(self.slope * products + self.offset)
