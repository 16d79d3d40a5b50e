"""Representations of h: what a step adds, how projections and random features compare with the kernel itself."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from functions import as_dtype, gaussian_sum, points, rkhs_norm, stepped, value

from common.kernels.gaussian import Gaussian
from common.kernels.laplacian import Laplacian
from common.maths.gram import gram
from common.maths.rkhs.basis import Basis
from common.maths.rkhs.exact import Exact
from common.maths.rkhs.fourier import Fourier, frequencies
from common.maths.rkhs.nystrom import Nystrom

WIDTH = 2.0
KERNEL = Gaussian(WIDTH)
Z, ALPHA, ELSEWHERE = points(12, 3), points(12, 2, seed=1), points(20, 3, seed=2)


def fourier(features: int, seed: int = 0) -> Fourier:
    return Fourier(KERNEL, features, seed)


def test_one_transition_changes_h_by_alpha_times_the_kernel() -> None:
    """Without momentum h moves by exactly alpha K(c, .), and v is that too."""
    exact = Exact(KERNEL, 4)
    h, momentum = stepped(exact, exact.empty(3, 2), Z[:1], ALPHA[:1])
    expected = gaussian_sum(Z[:1], ALPHA[:1], ELSEWHERE, WIDTH)
    np.testing.assert_allclose(value(exact, h, ELSEWHERE), expected, rtol=2e-5, atol=1e-6)
    v = exact.velocity(h, momentum, jnp.asarray(ELSEWHERE, jnp.float32))
    np.testing.assert_allclose(v, expected, rtol=2e-5, atol=1e-6)


def test_averaging_leaves_h_as_it_is() -> None:
    """The direction is found first; h moves only when the step is applied."""
    exact = Exact(KERNEL, 24)
    state = stepped(exact, exact.empty(3, 2), Z, ALPHA)
    new = exact.average(
        *state, jnp.asarray(Z + 1, jnp.float32), jnp.asarray(ALPHA, jnp.float32), lambda k: None, decay=0.9
    )
    np.testing.assert_array_equal(value(exact, new[0], ELSEWHERE), value(exact, state[0], ELSEWHERE))


def test_age_and_size_of_exact_centres() -> None:
    """Two new centres an update, room for 5: after 4 updates the ages are 0 0 1 1 2."""
    exact = Exact(KERNEL, 5)
    state = exact.empty(3, 2)
    for i in range(4):
        state = stepped(exact, state, Z[2 * i : 2 * i + 2], ALPHA[:2])
    assert int(exact.size(*state)) == 5
    assert float(exact.age(state[1], 2)) == pytest.approx((0 + 0 + 1 + 1 + 2) / 5)


def test_the_norm_of_h_is_the_root_of_the_quadratic_form() -> None:
    """|h|^2 = sum_ij w_i w_j K(c_i, c_j)."""
    exact = Exact(KERNEL, 16)
    h, _ = stepped(exact, exact.empty(3, 2), Z, ALPHA)
    assert float(exact.norm(h)) == pytest.approx(rkhs_norm(Z, ALPHA, WIDTH), rel=1e-4)


def test_nystrom_with_every_point_a_landmark_is_exact() -> None:
    """Two steps with momentum over the same 12 points, in float64: the same function as with centres."""
    with jax.enable_x64(True):
        nystrom, exact = Nystrom(KERNEL, 12, 0), Exact(KERNEL, 24)
        ours, theirs = (as_dtype(r.empty(3, 2), jnp.float64) for r in (nystrom, exact))
        for alpha in (ALPHA, 2 * ALPHA[::-1]):
            ours = stepped(nystrom, ours, Z, alpha, decay=0.9)
            theirs = stepped(exact, theirs, Z, alpha, decay=0.9)
        np.testing.assert_allclose(value(nystrom, ours[0], ELSEWHERE), value(exact, theirs[0], ELSEWHERE), rtol=1e-9)
        assert float(nystrom.norm(ours[0])) == pytest.approx(float(exact.norm(theirs[0])), rel=1e-9)


def test_nystrom_projects_orthogonally() -> None:
    """What is lost of a gradient is orthogonal to every K(c_l, .): both have the same values at the landmarks."""
    with jax.enable_x64(True):
        nystrom = Nystrom(KERNEL, 5, 0)
        state = as_dtype(nystrom.empty(3, 2), jnp.float64)
        h, momentum = stepped(nystrom, state, Z, ALPHA, landmarks=ELSEWHERE)
        landmarks = ELSEWHERE[:5]
        np.testing.assert_allclose(value(nystrom, h, landmarks), gaussian_sum(Z, ALPHA, landmarks, WIDTH), rtol=1e-9)
        # A projection is no longer than what it projects.
        assert float(nystrom.norm(h)) < rkhs_norm(Z, ALPHA, WIDTH)
        assert float(nystrom.age(momentum, 12)) == 0.0


def test_new_landmarks_take_h_over() -> None:
    """Landmarks chosen anew at every second update: h keeps its values at the new ones, and its shape."""
    with jax.enable_x64(True):
        nystrom = Nystrom(KERNEL, 6, 2)
        state = as_dtype(nystrom.empty(3, 2), jnp.float64)
        nothing = np.zeros_like(ALPHA)
        state = stepped(nystrom, state, Z, ALPHA, landmarks=Z)
        second = stepped(nystrom, state, Z, nothing, landmarks=ELSEWHERE)
        np.testing.assert_array_equal(second[0].centres, Z[:6])
        third = stepped(nystrom, second, Z, nothing, landmarks=ELSEWHERE)
        np.testing.assert_array_equal(third[0].centres, ELSEWHERE[:6])
        before = value(nystrom, second[0], ELSEWHERE[:6])
        np.testing.assert_allclose(value(nystrom, third[0], ELSEWHERE[:6]), before, rtol=1e-9)


def test_nystrom_in_single_precision_with_nearly_equal_landmarks() -> None:
    """Landmarks 1e-3 apart make a Gram matrix of rank 4 or so; the projection stays accurate and small."""
    close = 1e-3 * points(32, 3, seed=5)
    nystrom = Nystrom(KERNEL, 32, 0)
    h, _ = stepped(nystrom, nystrom.empty(3, 2), close[:12], ALPHA, landmarks=close)
    np.testing.assert_allclose(value(nystrom, h, close), gaussian_sum(close[:12], ALPHA, close, WIDTH), atol=2e-3)


def test_fourier_features_err_as_theory_says() -> None:
    """The error of K(x, y) over 40 draws: sqrt(Var cos(w (x - y)) / pairs), which falls like M^-1/2.

    Var cos(w r) = (1 + K(2r)) / 2 - K(r)^2, as cos^2 = (1 + cos 2)/2.
    """
    x, y = np.zeros(3), np.array([1.0, 0.5, -0.5])
    k = np.exp(-1.5 / WIDTH)
    per_pair = (1 + np.exp(-4 * 1.5 / WIDTH)) / 2 - k**2
    pair = jnp.asarray(np.stack([x, y]), jnp.float32)

    def error(features: int) -> float:
        def squared(seed: jax.Array) -> jax.Array:
            key = jax.random.fold_in(jax.random.key(7), seed)
            frequencies = jax.random.normal(key, (features // 2, 3), jnp.float32) * np.float32((2 / WIDTH) ** 0.5)
            function = fourier(features).empty(3, 2)[0]
            phi = fourier(features).activations(type(function)(frequencies, function.weights), pair)
            return jnp.square(phi[0] @ phi[1] - k)

        return float(jnp.sqrt(jnp.mean(jax.jit(jax.vmap(squared))(jnp.arange(400)))))

    measured = [error(features) for features in (16, 64, 256)]
    expected = [np.sqrt(per_pair / (features / 2)) for features in (16, 64, 256)]
    # A root mean square over 400 draws is good to 1/sqrt(800) = 3.5 %.
    np.testing.assert_allclose(measured, expected, rtol=0.12)


def test_fourier_features_converge_to_the_kernel() -> None:
    """The spectra that runs draw from: Gaussian and Laplacian Gram matrices to within five standard errors."""
    x = jnp.asarray(ELSEWHERE, jnp.float32)
    embeddings = [fourier(8192), Fourier(Laplacian(WIDTH), 8192, 3)]
    for representation in embeddings:
        function, _ = representation.empty(3, 2)
        phi = np.asarray(representation.activations(function, x))
        np.testing.assert_allclose(phi @ phi.T, gram(representation.kernel, x, x), atol=5 / np.sqrt(4096))


def test_the_laplacian_spectrum_is_cauchy_in_every_direction() -> None:
    """A coordinate of w bandwidth is Cauchy: half of all values lie within 1, whatever the size of w."""
    w = np.asarray(frequencies(Laplacian(0.5), jax.random.key(1), 4000, 3)) * 0.5
    assert np.mean(np.abs(w) < 1) == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(12000) * 2)


def test_no_laplacian_frequency_dwarfs_the_others() -> None:
    """The largest of 128 is a few times the median; the expected K stays within the error of so many draws, 0.09.

    1/|u| is at most 1 / 0.11, the 0.088 quantile of |u| (128^-1/2 = 0.088), and 1 / 0.67 at the median: 6 times. In
    three dimensions |g| spreads by another factor of 3 or so. An unbounded draw has a largest of some 128 medians.
    """
    w = np.linalg.norm(frequencies(Laplacian(0.5), jax.random.key(0), 128, 3), axis=1)
    assert w.max() / np.median(w) < 20
    u = np.random.default_rng(0).standard_normal((200_000, 1))
    bounded = Laplacian(0.5).frequency_scale(u, 128**-0.5, np)
    for r in (0.01, 0.1, 0.5, 2.0):
        assert np.mean(np.exp(-0.5 * (bounded * r) ** 2)) == pytest.approx(np.exp(-r / 0.5), abs=128**-0.5)


def test_a_batch_gradient_of_features_is_the_sum_of_its_transitions() -> None:
    """phi(Z)^T alpha at once, or one transition at a time: the same h = sum_k alpha_k phi(z_k) phi(.)."""
    rff = fourier(32)
    at_once, momentum = stepped(rff, rff.empty(3, 2), Z, ALPHA)
    one_by_one = rff.empty(3, 2)
    for z, alpha in zip(Z, ALPHA, strict=True):
        one_by_one = stepped(rff, one_by_one, z[None], alpha[None])
    np.testing.assert_allclose(at_once.weights, one_by_one[0].weights, atol=1e-5)
    phi = np.asarray(rff.activations(at_once, jnp.asarray(Z, jnp.float32)))
    other = np.asarray(rff.activations(at_once, jnp.asarray(ELSEWHERE, jnp.float32)))
    np.testing.assert_allclose(value(rff, at_once, ELSEWHERE), other @ phi.T @ ALPHA, atol=1e-4)
    # Orthonormal features: the norm of h is that of its weights.
    assert float(rff.norm(at_once)) == pytest.approx(np.linalg.norm(np.asarray(at_once.weights)), rel=1e-5)
    assert int(momentum.added) == 1


def test_the_basis_is_that_of_the_gaussian_kernel() -> None:
    """sum_a e_a(x) e_a(y) = K(x, y): in two variables degree 12 leaves (2 x y / s2)^13 / 13! of the series."""
    x = points(6, 2, seed=4)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    basis = Basis(KERNEL, 91, 2, 0)  # 91 = (12 + 1)(12 + 2) / 2
    function, _ = basis.empty(2, 1)
    e = np.asarray(basis.activations(function, jnp.asarray(x, jnp.float32)), np.float64)
    assert e.shape == (6, 91)
    np.testing.assert_allclose(e @ e.T, gaussian_sum(x, np.eye(6), x, WIDTH), atol=2e-6)


def test_functions_of_the_basis() -> None:
    """Order 1, y1, y2, y1^2, y1 y2, y2^2 with factors sqrt((2/s2)^|a| / a!), times exp(-|y|^2/s2); s2 = 2."""
    basis = Basis(KERNEL, 6, 2, 0)
    function, _ = basis.empty(2, 1)
    e = np.asarray(basis.activations(function, jnp.asarray([[0.5, 2.0]], jnp.float32)))[0]
    root = np.sqrt(0.5)
    expected = np.exp(-4.25 / 2) * np.array([1.0, 0.5, 2.0, root * 0.25, 1.0, root * 4.0])
    np.testing.assert_allclose(e, expected, rtol=1e-5)


def test_directions_of_the_basis_keep_lengths_on_average() -> None:
    """Fewer directions than features: orthogonal, each of length sqrt(d / variables)."""
    function, _ = Basis(KERNEL, 10, 4, 0).empty(16, 1)
    np.testing.assert_allclose(function.directions @ function.directions.T, 4.0 * np.eye(4), atol=1e-5)
