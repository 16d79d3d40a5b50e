"""Matrix products of the hidden layers in bfloat16: factors rounded to 8 bits of mantissa, sums in float32."""

from __future__ import annotations

from typing import Any, Literal

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

Precision = Literal["float32", "bfloat16"]

_ROWS_BY_COLUMNS = (((1,), (0,)), ((), ()))


def _multiply(x: Array, y: Array) -> Array:
    return jnp.matmul(x.astype(jnp.bfloat16), y.astype(jnp.bfloat16), preferred_element_type=jnp.float32)


# Left to itself, JAX multiplies the float32 gradient by the bfloat16 factor in float32, at the price of float32.
@jax.custom_vjp
def bfloat16_product(x: Float[Array, "B K"], y: Float[Array, "K M"]) -> Float[Array, "B M"]:
    """x @ y, with both products of its gradient in bfloat16, too."""
    return _multiply(x, y)


def _forward(x: Array, y: Array) -> tuple[Array, tuple[Array, Array]]:
    return _multiply(x, y), (x.astype(jnp.bfloat16), y.astype(jnp.bfloat16))


def _backward(factors: tuple[Array, Array], slope: Array) -> tuple[Array, Array]:
    x, y = factors
    return _multiply(slope, y.T), _multiply(x.T, slope)


bfloat16_product.defvjp(_forward, _backward)


def bfloat16_dot_general(x: Array, y: Array, dimensions: Any, **_: Any) -> Array:
    """`bfloat16_product` with the signature that `nnx.Linear` expects of its product."""
    if dimensions != _ROWS_BY_COLUMNS:
        raise ValueError(f"only [B, K] by [K, M] is multiplied in bfloat16, not dimensions {dimensions}")
    return bfloat16_product(x, y)
