"""The linear kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

from jaxtyping import Float

from common.kernels.kernel import Array, Kernel, Parameters, Property


@final
@dataclass(frozen=True)
class Linear(Kernel):
    """K(x, y) = <x, y> (paper, section D.4). Positive semi-definite of rank d: h is a linear map."""

    name: ClassVar[str] = "linear"
    properties: ClassVar[frozenset[Property]] = frozenset({"positive semi-definite"})

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> Linear:
        return cls()

    def of(
        self, products: Float[Array, "B M"], x_squared: Float[Array, "B 1"], y_squared: Float[Array, "1 M"], xp: Any
    ) -> Float[Array, "B M"]:
        return products
