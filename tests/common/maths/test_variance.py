"""The variance laboratory against NumPy, Monte Carlo and the paper's theorems."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from functions import gaussian_sum, points, stepped
from small_learners import random_batch, small_learner

from common.config.settings import RunSettings
from common.kernels.gaussian import Gaussian
from common.kernels.linear import Linear
from common.maths.diagnostics import MEASURED
from common.maths.rkhs.clustering import Cluster
from common.maths.rkhs.matching_pursuit import KernelMatchingPursuit
from common.maths.variance import (
    gradient_variance,
    linear_ratio,
    score_variance,
    three_gradients,
    variance_ratio,
)

Z, ALPHA = points(30, 4), points(30, 3, seed=1)


def test_equation_10_is_the_sample_variance_of_a_linear_kernel() -> None:
    """With K(x, y) = x y the gradient alpha K(z, .) is the matrix alpha z^T: NumPy's variance of those, summed."""
    with jax.enable_x64(True):
        gradients = np.einsum("ta,td->tad", ALPHA, Z).reshape(30, -1)
        expected = np.var(gradients, axis=0).sum()
        assert float(gradient_variance(Linear(), jnp.asarray(Z), jnp.asarray(ALPHA))) == pytest.approx(
            expected, rel=1e-12
        )


def test_equation_10_for_the_gaussian_kernel() -> None:
    """The three terms of the equation, summed as they stand."""
    k = gaussian_sum(Z, np.eye(30), Z, 2.0)
    products = ALPHA @ ALPHA.T * k
    terms = [products[t, t] - 2 * products[:, t].sum() / 30 + products.sum() / 30**2 for t in range(30)]
    with jax.enable_x64(True):
        found = gradient_variance(Gaussian(2.0), jnp.asarray(Z), jnp.asarray(ALPHA))
    assert float(found) == pytest.approx(np.mean(terms), rel=1e-12)


def test_the_measured_ratio_to_the_linear_policy() -> None:
    """One variance by the other, on the same transitions, both summed in NumPy."""

    def by_hand(k: np.ndarray) -> float:
        products = ALPHA @ ALPHA.T * k
        return float(np.trace(products) / 30 - products.sum() / 30**2)

    expected = by_hand(gaussian_sum(Z, np.eye(30), Z, 2.0)) / by_hand(Z @ Z.T)
    with jax.enable_x64(True):
        found = linear_ratio(Gaussian(2.0), jnp.asarray(Z), jnp.asarray(ALPHA))
    assert float(found) == pytest.approx(expected, rel=1e-12)


def test_lemma_3_1_is_what_monte_carlo_finds() -> None:
    """Var of S^-1 (a - m)(c a + d): 2 c^2 + (c m + d)^2 / S at c = 2, m = 0.5, S = 0.49.

    For d = -1 that is 8 + 0, for d = 1 it is 8 + 4 / 0.49.
    """
    c, m, s = 2.0, 0.5, 0.49
    a = m + np.sqrt(s) * np.random.default_rng(0).standard_normal(1_000_000)
    for d, expected in ((-1.0, 8.0), (1.0, 8.0 + 4 / 0.49)):
        closed = score_variance(jnp.float32(c), jnp.float32(d), jnp.float32(m), jnp.float32(s))
        assert float(closed) == pytest.approx(expected, rel=1e-6)
        assert np.var((a - m) / s * (c * a + d)) == pytest.approx(expected, rel=0.02)


def test_the_variance_ratio_and_its_lower_bound() -> None:
    """R at s = (3, 4): K/|s|^2 = 1/25; RKHS policy c = 1, d = 0, m = 1 and linear c = 2, d = 1, m = 0, S = 0.5.

    (2 + 1/0.5) / (8 + 1/0.5) = 0.4, over 25. The lemma's bound drops h's offset: 2 / 10 over 25.
    """

    def of(*numbers: float) -> tuple[jax.Array, ...]:
        return tuple(jnp.asarray([number], jnp.float32) for number in numbers)

    state = jnp.asarray([[3.0, 4.0]], jnp.float32)
    ratio = variance_ratio(Gaussian(1.0), state, of(1.0, 0.0, 1.0), of(2.0, 1.0, 0.0), jnp.float32(0.5))
    assert float(ratio[0]) == pytest.approx(0.4 / 25, rel=1e-5)
    assert float(ratio[0]) >= 0.2 / 25


def sampled(states: int, actions: int) -> tuple[np.ndarray, ...]:
    """Transitions of one policy that satisfy Theorem 3.2: per state many actions with their true Q, V and A.

    h = 0, mu = 0.5, S = 0.01, cut where a - h >= mu / 2 would fail, at 2.4 standard deviations. Q = V + 0.1 (a - m)
    with V = 2 stays above V / 2.
    """
    rng = np.random.default_rng(3)
    noise = np.clip(0.1 * rng.standard_normal((states, actions)), -0.24, 0.24)
    noise -= noise.mean(axis=1, keepdims=True)
    mean = 0.5
    a = mean + noise
    value = np.full_like(a, 2.0)
    advantage = 0.1 * (a - mean)
    return a, value, advantage


def test_theorem_3_2_orders_the_three_variances() -> None:
    """Var with Q >= Var with A >= Var with A and the residual, at every one of 20 states with 2,000 actions each.

    At one state K(s, s) = 1 for all actions, so equation 10 is the variance over actions of the theorem.
    """
    actions, values, advantages = sampled(20, 2000)
    assert (actions >= 0.25).all()
    assert (values + advantages >= values / 2).all()
    with jax.enable_x64(True):
        state = jnp.zeros((2000, 1))
        variance = jax.jit(lambda alpha: gradient_variance(Gaussian(1.0), state, alpha))
        for a, v, adv in zip(actions, values, advantages, strict=True):
            gradients = three_gradients(
                jnp.asarray(a[:, None]),
                jnp.zeros((2000, 1)),
                jnp.full((2000, 1), 0.5),
                jnp.full(1, np.log(0.1)),
                jnp.asarray(v),
                jnp.asarray(adv),
            )
            with_q, with_a, with_residual = (float(variance(alpha)) for alpha in gradients)
            assert with_q >= with_a >= with_residual > 0


def test_variances_are_measured_at_their_interval_without_another_compilation() -> None:
    """Measured at updates 0 and 2 of three; between, its figures are 0 and say so. One program for all."""
    settings = RunSettings.model_validate(
        {
            "num_envs": 16,
            "num_steps": 4,
            "actors": 1,
            "total_steps": 64 * 8,
            "algorithm": {"hidden": (8, 8), "minibatches": 4, "epochs": 1},
            "rkhs": {"variance_every": 2, "representation": "rff", "capacity": 8, "samples": "batch"},
        }
    )
    small = small_learner(settings, 3, 2)
    state, seen = small.start, []
    for i in range(3):
        batch = random_batch(small, i)
        # As a policy of mean 0 and deviation 1 acts, which this one is at first: no ratio is far from 1.
        log_prob = jnp.sum(-0.5 * jnp.square(batch.action) - 0.5 * np.float32(np.log(2 * np.pi)), axis=-1)
        state, metrics = small.step(state, replace(batch, log_prob=log_prob))
        seen.append({name: float(value) for name, value in metrics.items() if name.startswith("variance/")})
    assert small.step._cache_size() == 1
    assert [metrics[MEASURED] for metrics in seen] == [1.0, 0.0, 1.0]
    assert set(seen[1].values()) == {0.0}
    for metrics in (seen[0], seen[2]):
        # Q = A + V, in their means; the spread of the gradient is a positive number.
        assert metrics["variance/q_mean"] == pytest.approx(
            metrics["variance/a_mean"] + metrics["variance/v_mean"], abs=1e-5
        )
        assert all(metrics[f"variance/{name}"] > 0 for name in ("gradient", "of_q", "of_a", "of_a_residual"))


@functools.cache
def measured(**rkhs: Any) -> dict[str, float]:
    """The variance metrics of one update with these settings: d = 6, 64 transitions, h = 0 before."""
    sizes = {"num_envs": 16, "num_steps": 4, "actors": 1, "total_steps": 640, "algorithm": {"hidden": (6,)}}
    algorithm = {"algorithm": {"hidden": (6,), "minibatches": 1, "epochs": 1, "learning_rate": 1e-6}}
    rkhs = {"variance_every": 1, "capacity": 64, **rkhs}
    small = small_learner(RunSettings.model_validate(sizes | algorithm | {"rkhs": rkhs}), 3, 2)
    batch = random_batch(small, 0)
    log_prob = jnp.sum(-0.5 * jnp.square(batch.action) - 0.5 * np.float32(np.log(2 * np.pi)), axis=-1)
    _, metrics = small.step(small.start, replace(batch, log_prob=log_prob))
    return {name.removeprefix("variance/"): float(value) for name, value in metrics.items()}


def test_the_gradient_that_is_taken_is_measured() -> None:
    """n = 16 has 1/16 of one transition's variance, and keeps the figure of one transition.

    A representation has that of its own functions: the projection onto 8 landmarks is less than the whole, and so is
    the part in a basis of 8; eta scales coefficients by 0.1, variances by 0.01.
    """
    one, many = measured(samples=1), measured(samples=16)
    assert one["gradient"] == pytest.approx(one["one_transition"], rel=1e-3)
    assert many["one_transition"] == pytest.approx(one["one_transition"], rel=1e-4)
    assert many["gradient"] == pytest.approx(one["gradient"] / 16, rel=1e-3)
    landmarks = measured(samples=16, representation="nystrom", capacity=8)
    assert landmarks["one_transition"] == pytest.approx(one["one_transition"], rel=1e-4)
    assert 0.1 * many["gradient"] < landmarks["gradient"] < 0.999 * many["gradient"]


def test_pairs_are_measured_as_pairs() -> None:
    """The symmetric estimate has a variance of its own; that of one transition stays what it is."""
    score, pairs = measured(samples=16), measured(samples=16, estimate="symmetric")
    assert pairs["one_transition"] == pytest.approx(score["one_transition"], rel=1e-4)
    assert 0 < pairs["gradient"] != pytest.approx(score["gradient"], rel=0.01)


@pytest.mark.parametrize("make", [lambda k, m: Cluster(k, m, 0.5), lambda k, m: KernelMatchingPursuit(k, m, 0.0)])
def test_functions_that_stand_in_for_others(make: Any) -> None:
    """A transition on a centre has that centre's function: K(c_i, c_j), whether it joins it or is projected onto it."""
    kernel = Gaussian(2.0)
    representation = make(kernel, 16)
    centres = points(1, 3)
    state = stepped(representation, representation.empty(3, 1), centres, np.ones((1, 1)))
    near = jnp.asarray(np.concatenate([centres, centres + 1e-3]), jnp.float32)
    matrix = representation.gradient_gram(*state, near, 8)
    np.testing.assert_allclose(matrix, np.ones((2, 2)), atol=1e-3)
    far = jnp.asarray(centres + 10.0, jnp.float32)
    # Far from every centre it is a new centre of a cluster, while of a projection nothing is left.
    kept = 1.0 if isinstance(representation, Cluster) else 0.0
    np.testing.assert_allclose(representation.gradient_gram(*state, far, 8), [[kept]], atol=1e-3)
