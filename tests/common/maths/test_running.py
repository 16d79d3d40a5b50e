"""Running mean and variance."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import numpy_reference
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from common.maths import running
from common.maths.running import Moments

ROWS = 8
merge = jax.jit(running.merge)  # compiled once for each size of a part

values = nps.arrays(np.float32, (ROWS, 2), elements=st.floats(-100, 100, width=32))
cuts = st.lists(st.integers(1, ROWS - 1), unique=True, max_size=3).map(sorted)


def moments_of(parts: list[np.ndarray]) -> Moments:
    start = running.start(parts[0].shape[1:])
    return functools.reduce(lambda moments, part: merge(moments, jnp.asarray(part)), parts, start)


@given(values, cuts)
@settings(max_examples=60)
def test_moments_are_those_of_all_data_however_split(data, cuts):
    """Merged in any parts, mean and variance are NumPy's over all rows, but for the prior of weight 1e-4."""
    moments = moments_of(np.split(data, cuts))
    # The prior counts as 1e-4 rows of mean 0 and variance 1.
    mean, variance, count = numpy_reference.moments(np.zeros(2), np.ones(2), 1e-4, data.astype(np.float64))
    # Float32 on squares of up to 1e4, a few roundings.
    np.testing.assert_allclose(moments.mean, mean, atol=1e-4)
    np.testing.assert_allclose(moments.variance, variance, atol=2e-2, rtol=1e-5)
    np.testing.assert_allclose(moments.count, count, rtol=1e-6)
    # 1e-4 of 8 rows moves the mean by at most 100 * 1.25e-5, and the variance by at most that of 1e4.
    np.testing.assert_allclose(mean, data.mean(axis=0), atol=2e-3)
    np.testing.assert_allclose(variance, data.astype(np.float64).var(axis=0), atol=0.3)


def test_first_batch_by_hand():
    """After 1 and 3: mean 2, variance 1."""
    moments = running.merge(running.start(()), jnp.array([1.0, 3.0]))
    np.testing.assert_allclose(moments.mean, 2.0, rtol=1e-4)
    np.testing.assert_allclose(moments.variance, 1.0, rtol=1e-3)
    np.testing.assert_allclose(moments.count, 2.0001, rtol=1e-6)


def test_nothing_seen_changes_nothing():
    """Before any data values are standardised by mean 0 and variance 1: they stay as they are."""
    data = jnp.array([[0.5, -2.0]])
    np.testing.assert_allclose(running.standardise(running.start((2,)), data), data, rtol=1e-6)
    np.testing.assert_allclose(running.scale(running.start(()), data), data, rtol=1e-6)


def test_variance_survives_a_mean_far_from_zero():
    """Deviations of 1 around 1,000 keep their variance: squares of the values themselves are never subtracted."""
    rng = np.random.default_rng(0)
    data = (1000.0 + rng.standard_normal((4, 256, 1))).astype(np.float32)
    moments = moments_of(list(data))
    # float32 squares near 1e6 are 0.06 apart; a difference of two such means would be off by more than 1%.
    # The prior's part: 1e-4 rows at a distance of 1,000 add 1e-4 * 1e6 / 1,024 = 0.098 to the variance.
    np.testing.assert_allclose(moments.variance, data.astype(np.float64).var() + 1e-4 * 1e6 / 1024, rtol=2e-3)


def test_standardise_by_hand():
    """(x - mean) / std for each column."""
    moments = Moments(jnp.array([1.0, 10.0]), jnp.array([4.0, 0.25]), jnp.asarray(3.0))
    # (5 - 1) / 2 = 2 and (9 - 10) / 0.5 = -2; leading axes are batch axes.
    np.testing.assert_allclose(running.standardise(moments, jnp.array([[[5.0, 9.0]]])), [[[2.0, -2.0]]], rtol=1e-6)


def test_scale_by_hand():
    """x / std, the mean left in."""
    moments = Moments(jnp.asarray(10.0), jnp.asarray(4.0), jnp.asarray(3.0))
    np.testing.assert_allclose(running.scale(moments, jnp.array([10.0, -3.0])), [5.0, -1.5], rtol=1e-6)


def test_a_step_is_seen_by_moments_that_have_taken_it_in():
    """Two values of mean 0 and variance 1, weighing 2; then steps (2, 4) and (6, 6).

    After the first: mean (0 + 6) / 4 = 1.5, second moment (2 + 4 + 16) / 4 = 5.5, variance 3.25.
    After the second: mean (6 + 12) / 6 = 3, second moment (22 + 72) / 6 = 47 / 3, variance 20 / 3.
    """
    moments = Moments(jnp.asarray(0.0), jnp.asarray(1.0), jnp.asarray(2.0))
    steps = jnp.array([[2.0, 4.0], [6.0, 6.0]])
    after, seen = running.merge_and_standardise(moments, steps)
    first, second = np.sqrt(3.25), np.sqrt(20 / 3)
    np.testing.assert_allclose(seen, [[0.5 / first, 2.5 / first], [3 / second, 3 / second]], rtol=1e-6)
    np.testing.assert_allclose([after.mean, after.variance, after.count], [3.0, 20 / 3, 6.0], rtol=1e-6)
    # Rewards are scaled by the returns of their step and those before.
    _, scaled = running.merge_and_scale(moments, steps, jnp.array([[1.0, -1.0], [2.0, 0.0]]))
    np.testing.assert_allclose(scaled, [[1 / first, -1 / first], [2 / second, 0.0]], rtol=1e-6)
