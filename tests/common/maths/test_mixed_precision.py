"""Products of the hidden layers in bfloat16."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common.maths.mixed_precision import bfloat16_dot_general, bfloat16_product
from common.maths.networks import make_networks


def test_factors_are_rounded_and_sums_are_not():
    """1 + 2^-9 rounds to 1 in bfloat16 (8 bits of mantissa, ties to even), but 256 + 1 is kept in the sum."""
    x, y = jnp.array([[1.0 + 2.0**-9, 1.0]]), jnp.array([[256.0], [1.0]])
    product = bfloat16_product(x, y)
    assert product.dtype == jnp.float32
    assert float(product[0, 0]) == 257.0


def test_both_products_of_the_gradient_are_in_bfloat16():
    """The slope 1 + 2^-9 is rounded to 1 before it is multiplied: dx = slope y = 3, dy = x slope = 2; both float32."""
    _, pull = jax.vjp(bfloat16_product, jnp.array([[2.0]]), jnp.array([[3.0]]))
    dx, dy = pull(jnp.array([[1.0 + 2.0**-9]]))
    assert (float(dx[0, 0]), float(dy[0, 0])) == (3.0, 2.0)
    assert dx.dtype == dy.dtype == jnp.float32


def test_other_dimensions_are_refused():
    """Transposed factors would be multiplied wrongly without a word."""
    with pytest.raises(ValueError, match="dimensions"):
        bfloat16_dot_general(jnp.ones((2, 2)), jnp.ones((2, 2)), (((0,), (0,)), ((), ())))


def test_only_hidden_layers_change():
    """Parameters are the same float32 arrays; V is a float32 near the one of float32, and not the same."""
    plain, parameters = make_networks(3, 2, (8, 4), 0)
    mixed, same = make_networks(3, 2, (8, 4), 0, precision="bfloat16")
    jax.tree.map(np.testing.assert_array_equal, same, parameters)
    obs = jax.random.normal(jax.random.key(0), (16, 3))
    value, rounded = (networks.value(parameters["critic"], obs) for networks in (plain, mixed))
    assert rounded.dtype == jnp.float32
    assert 0.0 < float(jnp.max(jnp.abs(rounded - value))) < 0.05
