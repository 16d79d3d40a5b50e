"""The four kernels: formulas, positive semi-definiteness where it holds, and derivatives."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common.config.rkhs import RkhsSettings
from common.kernels import Kernel, make_kernel
from common.kernels.gaussian import Gaussian
from common.kernels.laplacian import Laplacian
from common.kernels.linear import Linear
from common.kernels.sigmoid import Sigmoid
from common.maths.gram import diagonal, gram

pytestmark = pytest.mark.usefixtures("in_a_hurry")

X, Y = np.array([[3.0, 4.0]]), np.array([[0.0, 0.0], [3.0, 0.0]])


def at(kernel: Kernel) -> np.ndarray:
    return np.asarray(gram(kernel, jnp.asarray(X, jnp.float32), jnp.asarray(Y, jnp.float32)))


@pytest.mark.parametrize(
    ("kernel", "expected"),
    [
        # |x - y| is 5 and 4, <x, y> is 0 and 9.
        (Gaussian(10.0), [np.exp(-25 / 10), np.exp(-16 / 10)]),
        (Laplacian(10.0), [np.exp(-5 / 10), np.exp(-4 / 10)]),
        (Linear(), [0.0, 9.0]),
        (Sigmoid(0.1, -0.5), [np.tanh(-0.5), np.tanh(0.4)]),
    ],
    ids=["gaussian", "laplacian", "linear", "sigmoid"],
)
def test_formula(kernel: Kernel, expected: list[float]) -> None:
    """Each kernel is its formula, at two pairs of points."""
    np.testing.assert_allclose(at(kernel), [expected], rtol=1e-6)


@pytest.mark.parametrize("kernel", [Gaussian(0.5), Laplacian(0.5), Linear()], ids=["gaussian", "laplacian", "linear"])
def test_positive_semi_definite(kernel: Kernel) -> None:
    """No Gram matrix has an eigenvalue below zero: 40 points, some of them twice, in float64."""
    with jax.enable_x64(True):
        points = np.random.default_rng(1).normal(size=(30, 3))
        points = np.concatenate([points, points[:10]])
        eigenvalues = np.linalg.eigvalsh(np.asarray(gram(kernel, jnp.asarray(points), jnp.asarray(points))))
    assert eigenvalues.min() > -1e-12 * eigenvalues.max() * len(points)


def test_the_sigmoid_kernel_is_not_positive_semi_definite() -> None:
    """tanh(x y - 1) at x = 0 is tanh(-1) < 0: a square that would be negative."""
    zero = jnp.zeros((1, 1), jnp.float32)
    assert float(gram(Sigmoid(1.0, -1.0), zero, zero)[0, 0]) == pytest.approx(np.tanh(-1.0))
    # Without offset too: for x = 1 and y = 3, K(x, x) K(y, y) = tanh(1) tanh(9) < tanh(3)^2.
    points = jnp.asarray([[1.0], [3.0]], jnp.float32)
    assert np.linalg.det(np.asarray(gram(Sigmoid(1.0, 0.0), points, points), np.float64)) < -0.1


@pytest.mark.parametrize("kernel", [Gaussian(0.5), Laplacian(0.5), Linear(), Sigmoid(2.0, 0.3)])
def test_diagonal_is_that_of_the_gram_matrix(kernel: Kernel) -> None:
    """K(x_i, x_i) without the rest."""
    points = jnp.asarray(np.random.default_rng(2).normal(size=(5, 3)), jnp.float32)
    # Rounding puts a point 1e-3.5 from itself, which the Laplacian sees.
    np.testing.assert_allclose(diagonal(kernel, points), jnp.diagonal(gram(kernel, points, points)), rtol=3e-3)


def test_the_laplacian_has_a_gradient_at_a_centre() -> None:
    """At distance 0, where the root has none, the gradient is 0; elsewhere -K/s times the direction."""

    def k(x: jax.Array, y: jax.Array) -> jax.Array:
        return gram(Laplacian(2.0), x[None], y[None])[0, 0]

    zero = jnp.zeros(2, jnp.float32)
    np.testing.assert_array_equal(jax.grad(k)(zero, zero), [0.0, 0.0])
    # x - y = (3, 4), |x - y| = 5: -exp(-5/2)/2 (3/5, 4/5)
    expected = -np.exp(-2.5) / 2 * np.array([0.6, 0.8])
    np.testing.assert_allclose(jax.grad(k)(jnp.asarray([3.0, 4.0]), zero), expected, rtol=1e-5)


def test_by_name() -> None:
    """Settings name a kernel; slope and offset are the sigmoid's."""
    assert at(make_kernel("sigmoid", RkhsSettings(slope=0.1, offset=-0.5)))[0, 1] == pytest.approx(
        np.tanh(0.4), rel=1e-6
    )
    assert at(make_kernel("laplacian", RkhsSettings(bandwidth=10.0)))[0, 0] == pytest.approx(np.exp(-0.5), rel=1e-6)
