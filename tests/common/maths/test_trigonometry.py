"""Cosine and sine by series: as good as single precision, in value and derivative."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common.maths.trigonometry import cos_sin


@pytest.mark.parametrize("largest", [1.0, 30.0, 1000.0])
def test_values(largest: float) -> None:
    """Against NumPy in double precision, over all quadrants of both signs."""
    x = np.linspace(-largest, largest, 20_001, dtype=np.float32)
    cosine, sine = jax.jit(cos_sin)(jnp.asarray(x))
    np.testing.assert_allclose(cosine, np.cos(x.astype(np.float64)), atol=2e-7)
    np.testing.assert_allclose(sine, np.sin(x.astype(np.float64)), atol=2e-7)


def test_no_value_beyond_one() -> None:
    """However large an argument is: at 1e8 the series without a bound gives 3,240."""
    x = jnp.asarray(np.geomspace(1e3, 1e30, 10_001), jnp.float32)
    for values in jax.jit(cos_sin)(jnp.concatenate([x, -x])):
        assert np.abs(np.asarray(values)).max() <= 1.0


def test_derivatives() -> None:
    """cos' = -sin and sin' = cos, at x = 2: -0.9093 and -0.4161, weighted by 1 and 10."""
    gradient = jax.grad(lambda x: cos_sin(x)[0] + 10.0 * cos_sin(x)[1])(jnp.float32(2.0))
    assert float(gradient) == pytest.approx(-np.sin(2.0) + 10 * np.cos(2.0), rel=1e-6)


def test_double_precision_is_left_to_the_library() -> None:
    """In float64 the result has all its digits."""
    with jax.enable_x64(True):
        cosine, sine = cos_sin(jnp.asarray([0.3, 100.0]))
    np.testing.assert_allclose(cosine, np.cos([0.3, 100.0]), rtol=1e-15)
    np.testing.assert_allclose(sine, np.sin([0.3, 100.0]), rtol=1e-14)
