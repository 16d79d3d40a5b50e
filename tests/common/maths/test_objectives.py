"""What is increased, case by case."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy_reference import drift as reference_drift

from common.maths import objectives

ALPHA, BETA = 2.0, 0.6

drift = jax.jit(functools.partial(objectives.drift, alpha=ALPHA, beta=BETA))
drifted = jax.jit(functools.partial(objectives.drifted, alpha=ALPHA, beta=BETA))
clipped = jax.jit(jax.value_and_grad(functools.partial(objectives.clipped, clip=0.2)))
clipped_value_loss = jax.jit(functools.partial(objectives.clipped_value_loss, clip=0.2))
normalised = jax.jit(objectives.normalised)


def one(x: float) -> jax.Array:
    return jnp.asarray(x, jnp.float32)


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected", "slope"),
    [
        # A > 0 and r beyond 1 + 0.2: held at 1.2 * 2, so nothing is gained by going further.
        (1.5, 2.0, 2.4, 0.0),
        # A > 0 and r below 1 - 0.2: r A = 1 is less than 0.8 * 2 = 1.6, so the way back stays open.
        (0.5, 2.0, 1.0, 2.0),
        # A < 0 and r beyond 1.2: r A = -3 is less than 1.2 * -2 = -2.4: the way back stays open.
        (1.5, -2.0, -3.0, -2.0),
        # A < 0 and r below 0.8: held at 0.8 * -2 = -1.6, which is less than 0.5 * -2 = -1.
        (0.5, -2.0, -1.6, 0.0),
        # Within the clip the objective is r A.
        (1.1, 2.0, 2.2, 2.0),
    ],
)
def test_clip_by_hand(ratio, advantage, expected, slope):
    """PPO's clip takes away only what would be gained by leaving the interval."""
    value, gradient = clipped(one(ratio), one(advantage))
    np.testing.assert_allclose(value, expected, rtol=1e-6)
    np.testing.assert_allclose(gradient, slope, rtol=1e-6)


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected"),
    [
        # A >= 0: x = (r - 1) A = 0.5 * 4 = 2; x - 2 tanh(x / 2) = 2 - 2 * 0.7615942 = 0.4768117.
        (1.5, 4.0, 0.4768117),
        # x = (3 - 1) * 0.5 = 1; 1 - 2 tanh(0.5) = 1 - 2 * 0.4621172 = 0.0757657.
        (3.0, 0.5, 0.0757657),
        # x = (0.5 - 1) * 4 = -2: x - 2 tanh(x / 2) = -0.477 < 0, so the drift is zero: going back is free.
        (0.5, 4.0, 0.0),
        # A < 0: x = log(r) A with r = exp(-1): x = -1 * -0.6 = 0.6; 0.6 - 0.6 tanh(1) = 0.6 * 0.2384058 = 0.1430435.
        (float(np.exp(-1)), -0.6, 0.1430435),
        # x = log(exp(-2)) * -0.3 = 0.6 too.
        (float(np.exp(-2)), -0.3, 0.1430435),
        # x = log(2) * -1 < 0: zero.
        (2.0, -1.0, 0.0),
    ],
)
def test_drift_by_hand(ratio, advantage, expected):
    """Lu et al.'s drift with alpha 2 and beta 0.6."""
    log_ratio = one(np.log(ratio))
    np.testing.assert_allclose(drift(log_ratio, one(advantage)), expected, atol=1e-6)
    np.testing.assert_allclose(drifted(log_ratio, one(advantage)), ratio * advantage - expected, rtol=1e-6)


def test_no_drift_where_the_policy_did_not_move():
    """At r = 1 the drift is zero and so is its slope: the first step is that of the plain policy gradient."""
    advantage = jnp.array([-3.0, -0.1, 0.0, 0.1, 3.0])
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(drift)))(jnp.zeros(5), advantage)
    np.testing.assert_array_equal(value, np.zeros(5))
    np.testing.assert_allclose(slope, np.zeros(5), atol=1e-6)


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected"),
    [
        # A < 0, r = 0.5: x = log 0.5 * -2 = 1.386; slope A tanh^2(x / 0.6) = -2 * 0.9806^2 = -1.923.
        (0.5, -2.0, -1.923),
        # A > 0, r = 2: x = 1; slope r A tanh^2(1 / 2) = 2 * 0.4621^2 = 0.4271.
        (2.0, 1.0, 0.4271),
        # r has moved against A: nothing holds it.
        (0.5, 2.0, 0.0),
        (2.0, -2.0, 0.0),
    ],
)
def test_slope_of_the_drift_by_hand(ratio, advantage, expected):
    """The derivative by log r, alpha 2 and beta 0.6; of r A - D it leaves -1 + 1.923 = +0.92 in the first case."""
    slope = objectives.drift_slope(jnp.log(one(ratio)), one(advantage), alpha=ALPHA, beta=BETA)
    np.testing.assert_allclose(slope, expected, atol=1e-3)


def test_drift_is_at_least_zero_everywhere():
    """The drift never rewards, and is what the equations say, over a grid of ratios and advantages."""
    log_ratio, advantage = (x.ravel() for x in np.meshgrid(np.linspace(-3, 2, 21), np.linspace(-4, 4, 17)))
    with jax.enable_x64(True):
        given = np.asarray(drift(jnp.asarray(log_ratio), jnp.asarray(advantage)))
    assert given.min() == 0.0
    expected = [reference_drift(np.exp(x), a, ALPHA, BETA) for x, a in zip(log_ratio, advantage, strict=True)]
    np.testing.assert_allclose(given, expected, atol=1e-12)


def test_drift_as_the_paper_prints_it_is_zero_for_negative_advantages():
    """With r A in place of log(r) A the second branch is zero for every ratio; Lu et al.'s is not.

    x - beta tanh(x / beta) <= 0 for x <= 0, and r A <= 0 where A < 0: the paper's printed drift cannot act there.
    """
    ratio, advantage = (x.ravel() for x in np.meshgrid(np.geomspace(0.05, 20, 41), -np.geomspace(0.01, 10, 31)))
    printed = np.maximum(0.0, ratio * advantage - BETA * np.tanh(ratio * advantage / BETA))
    assert printed.max() == 0.0
    with jax.enable_x64(True):
        ours = np.asarray(drift(jnp.asarray(np.log(ratio)), jnp.asarray(advantage)))
    # It acts where the policy already moved away from a bad action (r < 1), and nowhere else.
    assert (ours[ratio < 0.99] > 0.0).all()
    assert (ours[ratio > 1.0] == 0.0).all()


def test_clipped_value_loss_by_hand():
    """Half the mean of the larger squared error, with the value as it is or held within 0.2 of the old one."""
    value = jnp.array([1.0, 0.1, 1.0])
    old_value = jnp.array([0.0, 0.0, 0.0])
    target = jnp.array([1.0, 1.0, -1.0])
    # 1: the value hits its target, but held it is 0.2: (0.2 - 1)^2 = 0.64.
    # 2: within the clip: (0.1 - 1)^2 = 0.81.
    # 3: (1 + 1)^2 = 4 as it is, (0.2 + 1)^2 = 1.44 held: 4.
    expected = 0.5 * (0.64 + 0.81 + 4.0) / 3
    np.testing.assert_allclose(clipped_value_loss(value, old_value, target), expected, rtol=1e-6)


def test_normalised_by_hand():
    """Mean 0 and population standard deviation 1."""
    # 1, 3, 5: mean 3, variance (4 + 0 + 4) / 3 = 8/3.
    expected = np.array([-2.0, 0.0, 2.0]) / np.sqrt(8 / 3)
    np.testing.assert_allclose(normalised(jnp.array([1.0, 3.0, 5.0])), expected, rtol=1e-6)


def test_normalised_where_all_are_equal():
    """Equal advantages say nothing: they become zero, not a division by zero."""
    np.testing.assert_array_equal(normalised(jnp.full(4, 7.0)), np.zeros(4))
