"""Cosine and sine together, fast on a CPU."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

_COARSE = 1.5703125  # pi/2 in so few bits that small whole multiples of it are exact
_FINE = math.pi / 2 - _COARSE
_EIGHTH = math.pi / 4 + 1e-3
"""An eighth of a turn, and room for rounding."""


@jax.custom_jvp
def cos_sin(x: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """(cos x, sin x), in single precision to 2e-7 while abs(x) < 1,000, to abs(x) / 4e7 beyond, and never above 1.

    XLA calls the C library for each single cosine and sine on a CPU, at some nine times the cost of an exponential.
    These are the Taylor series on [-pi/4, pi/4], to which x is brought; they compile to vector instructions.
    """
    if x.dtype != jnp.float32:
        return jnp.cos(x), jnp.sin(x)
    quarters = jnp.round(x * (2.0 / math.pi))
    # Where rounding spoils r, for arguments of millions, the series must not be left: it grows like r^9.
    r = jnp.clip((x - quarters * _COARSE) - quarters * _FINE, -_EIGHTH, _EIGHTH)
    s = r * r
    sine = r * (1.0 + s * (-1 / 6 + s * (1 / 120 + s * (-1 / 5040 + s / 362880))))
    cosine = 1.0 + s * (-1 / 2 + s * (1 / 24 + s * (-1 / 720 + s / 40320)))
    turn = quarters.astype(jnp.int32)
    odd = turn & 1 == 1
    return (
        jnp.where((turn + 1) & 2 == 2, -1.0, 1.0) * jnp.where(odd, sine, cosine),
        jnp.where(turn & 2 == 2, -1.0, 1.0) * jnp.where(odd, cosine, sine),
    )


@cos_sin.defjvp
def _derivative(primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    cosine, sine = cos_sin(primals[0])
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])
