"""The diagonal Gaussian."""

import jax
import jax.numpy as jnp
import numpy as np
from numpy_reference import log_prob as reference_log_prob

from common.maths import gaussians

log_prob = jax.jit(gaussians.log_prob)
entropy = jax.jit(gaussians.entropy)
score = jax.jit(gaussians.score)
kl_of_means = jax.jit(gaussians.kl_of_means)
sample = jax.jit(gaussians.sample)

MEAN = jnp.array([1.0, -2.0])
LOG_STD = jnp.asarray(np.log([2.0, 0.5]), jnp.float32)
ACTION = jnp.array([3.0, -1.0])


def test_log_prob_by_hand():
    """The log-density of the components, summed."""
    # Standardised: (3 - 1) / 2 = 1 and (-1 + 2) / 0.5 = 2, so the squares sum to 5; log 2 + log 0.5 = 0.
    expected = -0.5 * 5 - 0.0 - np.log(2 * np.pi)
    np.testing.assert_allclose(log_prob(MEAN, LOG_STD, ACTION), expected, rtol=1e-6)


def test_log_prob_of_a_batch():
    """Leading axes are batch axes."""
    rng = np.random.default_rng(0)
    mean, action = rng.standard_normal((2, 4, 3, 2))
    log_std = rng.standard_normal(2)
    expected = [[reference_log_prob(mean[i, j], log_std, action[i, j]) for j in range(3)] for i in range(4)]
    with jax.enable_x64(True):
        given = log_prob(jnp.asarray(mean), jnp.asarray(log_std), jnp.asarray(action))
    np.testing.assert_allclose(given, expected, rtol=1e-12)


def test_entropy_by_hand():
    """log(std) + log(2 pi e) / 2 for each component."""
    # log 2 + log 0.5 = 0, and two components of log(2 pi e) / 2.
    np.testing.assert_allclose(entropy(LOG_STD), np.log(2 * np.pi * np.e), rtol=1e-6)


def test_entropy_is_the_mean_surprise():
    """Entropy is the expectation of -log p, here exact: E|standardised|^2 is the number of components."""
    log_std = jnp.array([0.3, -0.2, 0.1])
    # An action one standard deviation off in every component has exactly the expected square of each.
    one_off = log_prob(jnp.zeros(3), log_std, jnp.exp(log_std))
    np.testing.assert_allclose(entropy(log_std), -one_off, rtol=1e-6)


def test_score_by_hand():
    """Sigma^-1 (a - m)."""
    # (3 - 1) / 2^2 = 0.5 and (-1 + 2) / 0.5^2 = 4.
    np.testing.assert_allclose(score(MEAN, LOG_STD, ACTION), [0.5, 4.0], rtol=1e-6)


def test_score_is_the_gradient_in_the_mean():
    """The score is what differentiation of the log-probability gives."""
    gradient = jax.jit(jax.grad(gaussians.log_prob))(MEAN, LOG_STD, ACTION)
    np.testing.assert_allclose(score(MEAN, LOG_STD, ACTION), gradient, rtol=1e-6)


def test_kl_of_means_by_hand():
    """Half the squared distance of the means in standard deviations; zero for the same mean."""
    # Distances 2 / 2 = 1 and 1 / 0.5 = 2: (1 + 4) / 2.
    np.testing.assert_allclose(kl_of_means(MEAN, ACTION, LOG_STD), 2.5, rtol=1e-6)
    assert kl_of_means(MEAN, MEAN, LOG_STD) == 0.0


def test_sample_has_the_mean_and_the_standard_deviation():
    """Draws have the Gaussian's moments, and components are independent."""
    count = 40_000
    draws = np.asarray(sample(jax.random.key(1), jnp.tile(MEAN, (count, 1)), LOG_STD))
    standardised = (draws - [1.0, -2.0]) / [2.0, 0.5]
    # The mean of 40,000 standard normals has a standard deviation of 1/200, their mean square of sqrt(2)/200, the
    # mean product of two independent ones of 1/200. Five of these: 0.025, 0.036, 0.025.
    np.testing.assert_allclose(standardised.mean(axis=0), 0.0, atol=0.025)
    np.testing.assert_allclose((standardised**2).mean(axis=0), 1.0, atol=0.036)
    assert abs((standardised[:, 0] * standardised[:, 1]).mean()) < 0.025


def test_sample_is_a_function_of_its_key():
    """The same key gives the same action, another key another."""
    one, again, other = (sample(jax.random.key(seed), MEAN, LOG_STD) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
