"""The kernel critic: what it fits, what it values, and what a run without it keeps."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_learners import SmallLearner, changed, probe_learner, random_batch, small_learner

from common.config.critic import CriticSettings
from common.maths import trees
from common.maths.critic.functions import make_functions
from common.maths.critic.kernel_critic import Correction, make_kernel_critic

RIDGE = 0.1


def with_critic(name: str = "dpo", **critic: Any) -> SmallLearner:
    """A small learner for one observation and one action, with a kernel critic."""
    settings = probe_learner(name).settings
    return small_learner(settings.model_copy(update={"critic": CriticSettings(**{"ridge": RIDGE} | critic)}), 1, 1)


def with_algorithm(learner: SmallLearner, **algorithm: Any) -> SmallLearner:
    settings = learner.settings
    changes = {"algorithm": settings.algorithm.model_copy(update=algorithm)}
    return small_learner(settings.model_copy(update=changes), 1, 1)


def fit(learner: SmallLearner, observation: np.ndarray, target: np.ndarray, state: Any = None) -> tuple[Any, Any]:
    """The critic's state after a fit, compiled for nothing."""
    critic = learner.update.critic
    state = critic.empty() if state is None else state
    return critic.refit(
        state, learner.start.parameters, jnp.asarray(observation, jnp.float32), jnp.asarray(target, jnp.float32)
    )


def residual_data(learner: SmallLearner, residual: Any) -> tuple[np.ndarray, np.ndarray]:
    """Observations [T, E, 1] and the targets whose residual over the critic's network is that function of them."""
    observation = np.random.default_rng(0).standard_normal((5, 12, 1)).astype(np.float32)
    value = learner.networks.value(learner.start.parameters["critic"], jnp.asarray(observation.reshape(-1, 1)))
    return observation, residual(observation[..., 0]) + np.asarray(value).reshape(5, 12)


def test_landmarks_at_every_point_are_kernel_ridge_regression() -> None:
    """With every transition a landmark g(x) = K(x, X) (K + lambda I)^-1 y, lambda the ridge: K(x, x) = 1, so the mean
    eigenvalue of K is 1. Shrinkage off."""
    bandwidth = 2.0
    learner = with_critic(
        representation="nystrom", inputs="observations", capacity=60, bandwidth=bandwidth, shrink=False
    )
    observation, target = residual_data(learner, np.sin)
    state, _ = fit(learner, observation, target)
    x = observation.reshape(-1).astype(np.float64)
    gram = np.exp(-((x[:, None] - x[None, :]) ** 2) / bandwidth)
    expected = gram @ np.linalg.solve(gram + RIDGE * np.eye(60), np.sin(x))
    found = learner.update.critic.correction(state, learner.start.parameters, jnp.asarray(observation.reshape(-1, 1)))
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_fourier_features_are_the_kernel() -> None:
    """phi(x) @ phi(y) is exp(-|x - y|^2 / bandwidth) within the error of 4,096 features, sqrt(2 / 4096) = 0.02."""
    functions = make_functions(CriticSettings(representation="rff", capacity=4096, bandwidth=0.7), 3, seed=1)
    x = np.random.default_rng(0).standard_normal((20, 3)).astype(np.float32)
    phi = functions(functions.start(), jnp.asarray(x))
    squared = np.sum((x[:, None] - x[None]) ** 2, axis=2)
    np.testing.assert_allclose(phi @ phi.T, np.exp(-squared / 0.7), atol=0.08)


def test_a_linear_residual_is_found_and_generalises() -> None:
    """y = 3 - 2 x lies in the span of (x, 1): with hardly a penalty R^2 is 1 and the weights are the line."""
    learner = with_critic(representation="linear", inputs="observations", ridge=1e-6)
    observation, target = residual_data(learner, lambda x: 3.0 - 2.0 * x)
    state, metrics = fit(learner, observation, target)
    np.testing.assert_allclose(metrics["critic/held_out_r2"], 1.0, atol=1e-4)
    np.testing.assert_allclose(state.weights, [-2.0, 3.0], rtol=1e-3)


@pytest.mark.parametrize("representation", ["rff", "nystrom", "linear"])
def test_it_turns_itself_off_where_it_does_not_predict(representation: str) -> None:
    """A residual of opposite sign in the two halves of the environments: g is exactly 0."""
    learner = with_critic(representation=representation, inputs="observations", capacity=8)
    observation, _ = residual_data(learner, np.zeros_like)
    observation[:, 6:] = observation[:, :6]
    value = np.asarray(
        learner.networks.value(learner.start.parameters["critic"], jnp.asarray(observation.reshape(-1, 1)))
    ).reshape(5, 12)
    sign = np.where(np.arange(12) < 6, 1.0, -1.0)
    state, metrics = fit(learner, observation, value + sign)
    assert metrics["critic/held_out_r2"] < 0.0
    np.testing.assert_array_equal(state.weights, 0.0)


def test_shrinkage_is_the_held_out_r2() -> None:
    """The weights with shrinkage are R^2 times those without."""
    plain = with_critic(representation="rff", inputs="observations", capacity=8, shrink=False)
    shrunk = with_critic(representation="rff", inputs="observations", capacity=8)
    observation, target = residual_data(plain, lambda x: np.sin(x) + np.cos(40.0 * x))
    whole, metrics = fit(plain, observation, target)
    less, _ = fit(shrunk, observation, target)
    r2 = float(metrics["critic/held_out_r2"])
    assert 0.05 < r2 < 0.95
    np.testing.assert_allclose(less.weights, r2 * whole.weights, rtol=1e-5)


def test_an_odd_environment_is_left_out() -> None:
    """Thirteen environments: the last one, whatever it holds, changes nothing."""
    learner = with_critic(representation="linear", inputs="observations")
    observation, target = residual_data(learner, np.sin)
    expected, _ = fit(learner, observation, target)
    state, _ = fit(
        learner,
        np.concatenate([observation, np.full((5, 1, 1), 9.0)], axis=1),
        np.concatenate([target, np.full((5, 1), 1e3)], axis=1),
    )
    np.testing.assert_array_equal(state.weights, expected.weights)


@pytest.mark.parametrize(("inputs", "size"), [("features", 16), ("observations", 1), ("both", 17), ("critic", 16)])
def test_what_it_sees(inputs: str, size: int) -> None:
    """Features of the 16-wide networks, one observation, or both; `linear` has one weight more, for its constant."""
    learner = with_critic(representation="linear", inputs=inputs)
    state, _ = fit(learner, *residual_data(learner, np.sin))
    assert state.weights.shape == (size + 1,)
    assert np.isfinite(np.asarray(state.weights)).all()


def test_values_have_the_correction_and_the_networks_loss_has_not() -> None:
    """A constant correction c is a critic whose last bias is c higher: same advantages, so the policy moves alike.

    The value loss stays that of the network alone, held to the clip around its own old value.
    """
    # The clip of the gradient's norm would tie the policy's step to the value loss, which is not the same.
    apart = {"max_grad_norm": 1e6, "minibatches": 1, "epochs": 1}
    corrected, plain = (
        with_algorithm(learner, **apart) for learner in (with_critic(representation="linear"), probe_learner("dpo"))
    )
    c = 0.7
    constant = np.zeros(corrected.start.critic.weights.shape)
    constant[-1] = c
    bias = trees.to_arrays(plain.start)["parameters/critic/value/bias"] + c
    batch = random_batch(plain, 0)
    ours, our_metrics = corrected.step(changed(corrected.start, critic__weights=constant), batch)
    theirs, their_metrics = plain.step(changed(plain.start, parameters__critic__value__bias=bias), batch)
    for left, right in zip(
        jax.tree.leaves(ours.parameters["policy"]), jax.tree.leaves(theirs.parameters["policy"]), strict=True
    ):
        np.testing.assert_allclose(left, right, atol=1e-4)
    np.testing.assert_allclose(
        our_metrics["train/explained_variance"], their_metrics["train/explained_variance"], atol=1e-4
    )
    assert our_metrics["train/value_loss"] != pytest.approx(float(their_metrics["train/value_loss"]), rel=1e-3)


def test_an_update_fits_what_its_networks_left_over() -> None:
    """After an update g is the fit to `target - V_net` with the networks as they are then, on that batch's targets."""
    learner = with_critic(representation="rff", capacity=8)
    batch = random_batch(learner, 0)
    state, metrics = learner.step(learner.start, batch)
    assert isinstance(state.critic, Correction)
    # Without normalisation networks see observations as they are; g = 0 so far, so that V is the network's.
    update = learner.update
    samples = update._samples(learner.start, update._whitened(learner.start, batch), batch.reward)
    expected, _ = update.critic.refit(learner.start.critic, state.parameters, samples.obs, samples.target)
    np.testing.assert_allclose(state.critic.weights, expected.weights, atol=1e-3)
    assert metrics["finite/kernel critic"] == 1.0


def test_a_run_without_it_keeps_nothing_of_it() -> None:
    """No array of the state, no metric."""
    learner = probe_learner("dpo")
    assert not [name for name in trees.to_arrays(learner.start) if name.startswith("critic")]
    _, metrics = learner.step(learner.start, random_batch(learner, 0))
    assert not [name for name in metrics if "critic" in name]
    assert make_kernel_critic(learner.settings, learner.networks).empty() == learner.start.critic
