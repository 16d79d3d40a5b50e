"""The functional step: its coefficients, how far it goes, and that nothing about it is compiled twice."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_learners import small_learner

from common.config.settings import RunSettings
from common.maths import gaussians
from common.maths.functional import FunctionalStep
from common.maths.policy import Mean, Policy
from common.maths.samples import Pairs, Samples
from common.maths.trees import to_arrays

COUNT = 64


def functional(learner: str = "reskpn", **rkhs: Any) -> tuple[FunctionalStep, Any]:
    """The step of a small run with these settings, and the state it starts from."""
    sizes = {"num_envs": 16, "num_steps": 4, "actors": 1, "total_steps": 640, "algorithm": {"hidden": (6,)}}
    settings = RunSettings.model_validate(sizes | {"learner": learner, "rkhs": rkhs})
    small = small_learner(settings, 3, 2)
    return small.update.step, small.start


def transitions(seed: int = 0) -> Samples:
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> jax.Array:
        return jnp.asarray(rng.standard_normal(shape), jnp.float32)

    action = normal(COUNT, 2)
    log_prob = jnp.sum(-0.5 * jnp.square(action) - 0.5 * np.float32(np.log(2 * np.pi)), axis=1)
    return Samples(normal(COUNT, 3), action, log_prob, normal(COUNT), normal(COUNT))


NO_PAIRS = Pairs(transitions()[:0], transitions()[:0])


def run(step: FunctionalStep, state: Any, updates: int, **changes: Any) -> tuple[Any, Any, Any, Any]:
    """h, v and metrics after that many steps, and the compiled function."""
    compiled = jax.jit(step)
    function, momentum, metrics = state.expansion, state.representation_state, {}
    for i in range(updates):
        batch = transitions(i)
        function, momentum, metrics = compiled(
            function, momentum, state.parameters["policy"], batch, NO_PAIRS, jax.random.key(i)
        )
    return function, momentum, metrics, compiled


REPRESENTATIONS = ["exact", "nystrom", "rff", "kmp", "cluster", "basis"]


@pytest.mark.parametrize("name", REPRESENTATIONS)
def test_growth_past_the_budget_compiles_once(name: str) -> None:
    """Twenty steps of n = 4 into room for 16: one program, the shapes of the start, finite numbers."""
    step, state = functional(representation=name, capacity=16, samples=4, radius=0.05, step="trust-region")
    function, momentum, _, compiled = run(step, state, 20)
    assert compiled._cache_size() == 1
    shapes = jax.tree.map(jnp.shape, (state.expansion, state.representation_state))
    assert jax.tree.map(jnp.shape, (function, momentum)) == shapes
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((function, momentum)))
    assert int(step.representation.size(function, momentum)) == 16
    # A snapshot carries what evaluation needs: no average of gradients, no whitening matrix.
    arrays = to_arrays(Policy(state.parameters["policy"], function, state.observations))
    kept = {path for path in arrays if path.startswith("expansion/")}
    place = "directions" if name in ("rff", "basis") else "centres"
    assert kept == {f"expansion/{place}", "expansion/weights"}


@pytest.mark.parametrize("name", ["nystrom", "rff"])
def test_the_trust_region_spends_its_target(name: str) -> None:
    """After a step of the whole batch the mean KL of the old and new policy over the batch is the target, here 0.01.

    KL of N(m, S) and N(m + v, S) is v S^-1 v / 2; log_std is 0, so S = I. The first step moves h from 0 to s v.
    """
    step, state = functional(
        representation=name, capacity=16, samples="batch", step="trust-region", kl_target=0.01, momentum=0.5
    )
    function, _, metrics, _ = run(step, state, 1)
    batch = transitions(0)
    network = step.networks.bind_policy(state.parameters["policy"])
    features = network.features(batch.obs) * np.float32(6**-0.5)
    moved = np.asarray(step.representation.evaluate(function, features), np.float64)
    assert 0.5 * np.mean(np.sum(moved**2, axis=1)) == pytest.approx(0.01, rel=1e-3)
    assert float(metrics["rkhs/scale"]) > 0


def test_without_a_direction_there_is_no_step() -> None:
    """Equal advantages everywhere are normalised to 0: v = 0, and no division makes a number of it."""
    step, state = functional(representation="rff", capacity=16, samples="batch", step="trust-region")
    batch = transitions(0)
    batch = Samples(batch.obs, batch.action, batch.log_prob, batch.value, jnp.ones(COUNT, jnp.float32))
    function, _, _ = jax.jit(step)(
        state.expansion, state.representation_state, state.parameters["policy"], batch, NO_PAIRS, jax.random.key(0)
    )
    np.testing.assert_array_equal(function.weights, 0.0)


def test_shrinkage_gives_up_a_part_of_h() -> None:
    """h <- (1 - 0.25) h + s v."""
    step, state = functional(representation="exact", capacity=4)
    function = type(state.expansion)(state.expansion.centres, jnp.full((4, 2), 8.0, jnp.float32))
    momentum = type(state.representation_state)(jnp.full((4, 2), 0.5, jnp.float32), state.representation_state.added)
    shrunk = step.representation.apply(function, momentum, 2.0, shrinkage=0.25)
    np.testing.assert_array_equal(shrunk.weights, 0.75 * 8.0 + 2.0 * 0.5)


def test_the_whole_batch_is_the_mean_over_its_transitions() -> None:
    """alpha = 1/n (a - m) A with ratio 1, no drift and S = I; n = B draws every transition once."""
    step, _ = functional(representation="rff", capacity=16, samples="batch", momentum=0.0, eta=1.0)
    batch = transitions(0)
    mean = Mean(
        features=jnp.zeros((COUNT, 6), jnp.float32),
        rkhs=jnp.zeros((COUNT, 2), jnp.float32),
        residual=jnp.zeros((COUNT, 2), jnp.float32),
        log_std=jnp.zeros(2, jnp.float32),
    )
    advantage = np.asarray(batch.advantage, np.float64)
    advantage = (advantage - advantage.mean()) / advantage.std()
    alpha = step.coefficients(mean, batch, step.gain(batch), step.gain(batch))
    expected = np.asarray(batch.action) * advantage[:, None] / COUNT
    np.testing.assert_allclose(alpha, expected, atol=1e-6)


def test_the_symmetric_estimate_has_the_variance_of_its_slope_alone() -> None:
    """For Q = c a + d and a ~ N(m, S): Var is 2 c^2, against 2 c^2 + (c m + d)^2 / S of single actions.

    c = 1, d = 3, m = 2, S = 1/4: 2 against 102. A sample variance of 20,000 draws is good to about 1 %.
    """
    c, d, m, variance, count = 1.0, 3.0, 2.0, 0.25, 20_000
    noise = np.random.default_rng(0).standard_normal(count).astype(np.float32)
    step, _ = functional("kpn", samples=1, eta=1.0, capacity=4)
    mean = Mean(jnp.zeros((count, 6)), jnp.zeros((count, 1)), jnp.full((count, 1), m), jnp.full(1, np.log(0.5)))

    def taken(action: np.ndarray) -> Samples:
        """With V = 0, so that the advantage is Q, under the policy that is still the one of now: ratio 1."""
        zero, a = jnp.zeros(count), jnp.asarray(action)[:, None]
        log_prob = gaussians.log_prob(mean.total, mean.log_std, a)
        return Samples(jnp.zeros((count, 3)), a, log_prob, zero, c * a[:, 0] + d)

    pairs = Pairs(taken(m + 0.5 * noise), taken(m - 0.5 * noise))
    every = dataclasses.replace(step, samples=count)
    _, alpha = every.from_pairs(lambda _: mean, pairs, jax.random.key(0))
    assert np.var(count * np.asarray(alpha, np.float64)) == pytest.approx(2 * c**2, rel=0.03)
    single = every.coefficients(mean, pairs.taken, pairs.taken.target, jnp.zeros(count))
    expected = 2 * c**2 + (c * m + d) ** 2 / variance
    assert np.var(count * np.asarray(single, np.float64)) == pytest.approx(expected, rel=0.03)
