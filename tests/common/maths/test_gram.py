"""Kernels and Gram matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps
from jaxtyping import TypeCheckError

from common.config.rkhs import RkhsSettings
from common.kernels import KERNELS, Kernel, make_kernel
from common.kernels.gaussian import Gaussian
from common.kernels.laplacian import Laplacian
from common.maths import gram as gram_matrices

gram = jax.jit(gram_matrices.gram, static_argnums=0)
HALF = Gaussian(0.5)
points = nps.arrays(np.float64, (6, 3), elements=st.floats(-3, 3))


def test_gaussian_by_hand():
    """K(x, y) = exp(-|x - y|^2 / bandwidth) for all pairs."""
    x = jnp.array([[0.0, 0.0], [3.0, 4.0]])
    y = jnp.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]])
    # Squared distances: from (0, 0): 0, 1, 9; from (3, 4): 9 + 16 = 25, 4 + 16 = 20, 0 + 16 = 16. Bandwidth 5.
    expected = np.exp([[0.0, -1 / 5, -9 / 5], [-25 / 5, -20 / 5, -16 / 5]])
    np.testing.assert_allclose(gram(Gaussian(5.0), x, y), expected, rtol=1e-6)


def test_wider_kernel_reaches_further():
    """The bandwidth is sigma squared: at distance sigma the kernel is exp(-1), whatever sigma."""
    for sigma in (0.5, 8.0):
        x, y = jnp.zeros((1, 1)), jnp.full((1, 1), sigma)
        np.testing.assert_allclose(gram(Gaussian(sigma**2), x, y), [[np.exp(-1.0)]], rtol=1e-6)


def test_a_point_with_itself_in_spite_of_rounding():
    """K(x, x) is never greater than 1, and 1 but for the rounding of |x|^2."""
    x = jnp.asarray(np.random.default_rng(0).standard_normal((500, 256)), jnp.float32)
    diagonal = np.asarray(jnp.diagonal(gram(Gaussian(1.0), x, x)))
    # |x|^2 is about 256 = 2^8, so its float32 neighbours are 2^-15 = 3e-5 apart, and sums of three such can be a
    # few of these off: below zero for some x, which would make K greater than 1.
    squared = np.sum(np.square(x), axis=1)
    unclamped = 2 * squared - 2 * np.diagonal(np.asarray(x @ x.T))
    assert unclamped.min() < 0.0
    assert diagonal.max() == 1.0
    assert diagonal.min() > 1.0 - 1e-3


@pytest.mark.parametrize("kernel", [Gaussian(0.5), Gaussian(0.01), Laplacian(0.5)], ids=repr)
def test_a_large_observation_with_itself(kernel):
    """K(x, x) = 1 for 244 whitened numbers: |x|^2 is about 244, its float32 neighbours are 1.5e-5 apart.

    A few of those off, |x - x| is up to 1e-2: K is at least 1 - 1e-2 / 0.5 for the Laplacian, and for the Gaussian of
    bandwidth 0.01 at least 1 - 1e-4 / 0.01.
    """
    x = jnp.asarray(np.random.default_rng(0).standard_normal((100, 244)), jnp.float32)
    np.testing.assert_allclose(jnp.diagonal(gram(kernel, x, x)), 1.0, atol=0.03)


def test_matrix_products_are_asked_for_in_full_precision():
    """A GPU would multiply in TF32 otherwise, and K(x, x) above would be 0.6 and 0.003."""
    x = jnp.zeros((2, 3))
    program = str(jax.make_jaxpr(lambda a: gram_matrices.gram(HALF, a, a))(x))
    assert "dot_general" in program
    assert "HIGHEST" in program


@given(points)
@settings(max_examples=50)
def test_gram_matrix_is_positive_semi_definite(x):
    """For any points the Gram matrix is symmetric, its entries in [0, 1], its eigenvalues not negative."""
    with jax.enable_x64(True):
        matrix = np.asarray(gram(HALF, jnp.asarray(x), jnp.asarray(x)))
    # In float64 |x|^2 <= 27 is rounded at 2^-48 = 4e-15; 1e-12 leaves room for 6 x 6 of these over 0.5.
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert matrix.min() >= 0.0
    assert matrix.max() <= 1.0
    assert np.linalg.eigvalsh(matrix).min() > -1e-12


class Products(Kernel):
    """K(x, y) = <x, y>."""

    @classmethod
    def from_parameters(cls, parameters):
        return cls()

    def of(self, products, x_squared, y_squared, xp):
        return products


class Norms(Products):
    """K(x, y) = |x|^2 + |y|^2."""

    def of(self, products, x_squared, y_squared, xp):
        return 0.0 * products + x_squared + y_squared


def test_kernel_of_inner_products():
    """A kernel sees <x, y>, |x|^2 and |y|^2: the linear kernel is the first of these."""
    x, y = jnp.array([[1.0, 2.0], [0.0, 3.0]]), jnp.array([[4.0, 5.0]])
    # <(1, 2), (4, 5)> = 4 + 10 and <(0, 3), (4, 5)> = 15.
    np.testing.assert_array_equal(gram(Products(), x, y), [[14.0], [15.0]])
    # |(1, 2)|^2 = 5, |(0, 3)|^2 = 9, |(4, 5)|^2 = 41.
    np.testing.assert_array_equal(gram(Norms(), x, y), [[46.0], [50.0]])


def test_every_kernel_of_the_settings_can_be_made():
    """A name that the settings allow is a kernel here, and "gaussian" the Gaussian one."""
    x = jnp.array([[0.0], [1.0]])
    for name in KERNELS:
        assert gram(make_kernel(name, RkhsSettings(bandwidth=0.5)), x, x).shape == (2, 2)
    np.testing.assert_array_equal(gram(make_kernel("gaussian", RkhsSettings(bandwidth=0.5)), x, x), gram(HALF, x, x))


def test_shapes_are_checked():
    """The tests run with the annotations enforced: points of two sizes are refused."""
    with pytest.raises(TypeCheckError):
        gram(Gaussian(1.0), jnp.zeros((2, 3)), jnp.zeros((2, 4)))
