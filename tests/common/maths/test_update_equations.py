"""One update against the equations, written out in NumPy."""

import numpy as np
import numpy_reference as reference
import pytest
from small_learners import changed, random_batch
from update_cases import (
    BANDWIDTH,
    DRAWN,
    DRIFT_ALPHA,
    DRIFT_BETA,
    ETA,
    MOMENTUM,
    OLD_CENTRES,
    Case,
    case,
    in_the_middle,
    one_gradient_step,
    reference_moments,
    reference_policy,
)

from common.maths import trees

both_objectives = pytest.mark.parametrize("name", ["reskpn", "dpo"])


@both_objectives
def test_gradient_is_that_of_the_loss(name):
    """The networks move by minus the numeric gradient of the whole loss, h(psi(o)) differentiated too."""
    given = case(name)
    parameters = {key: given.before[key] for key in given.before if key.startswith(("policy/", "critic/"))}
    gradient = reference.numeric_gradient(lambda p: given.loss_parts(p)["loss"], parameters)
    norm = np.sqrt(sum(np.sum(g**2) for g in gradient.values()))
    for key, expected in gradient.items():
        moved = given.before[key] - given.after[key]
        np.testing.assert_allclose(moved, expected / (1 + np.abs(expected) / 1e4), atol=1e-4 * norm, err_msg=key)
    np.testing.assert_allclose(given.metrics["train/gradient_norm"], norm, rtol=1e-4)


@both_objectives
def test_losses_are_those_of_the_equations(name):
    """Policy loss, value loss, entropy, KL estimate and clip fraction over the batch, against NumPy."""
    given = case(name)
    expected = given.loss_parts({})
    for part in ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction"):
        np.testing.assert_allclose(given.metrics[f"train/{part}"], expected[part], rtol=1e-3, atol=1e-5, err_msg=part)


@both_objectives
def test_moments_take_in_the_batch(name):
    """Observation and return moments and the carried returns are those of all data; versions count up by one."""
    given = case(name)
    expected, _ = reference_moments(given.before, given.batch)
    for key, value in expected.items():
        np.testing.assert_allclose(given.after[key], value, rtol=1e-4, atol=1e-5, err_msg=key)
    assert given.after["version"] == given.before["version"] + 1
    np.testing.assert_array_equal(given.after["key"], given.before["key"])


def functional_gradient(given: Case, transition: reference.Transition) -> tuple[np.ndarray, float, float, float]:
    """alpha_k = eta / n rho_k Sigma^-1 (a_k - m(o_k)) (A_k - D_k), and its ratio, drift and advantage.

    m and Sigma with the networks as they are after training, h as it was before.
    """
    arrays = {**given.after, **{key: given.before[key] for key in ("expansion/centres", "expansion/weights")}}
    mean, log_std = reference_policy(arrays, transition.observation)
    ratio = np.exp(reference.log_prob(mean, log_std, transition.action) - transition.log_prob)
    drift = reference.drift(ratio, transition.advantage, DRIFT_ALPHA, DRIFT_BETA)
    held = min(ratio, min(max(ratio, 1 - 1.0), 1 + 1.0))
    score = (transition.action - mean) / np.exp(log_std) ** 2
    alpha = ETA / DRAWN * held * score * (transition.advantage - drift)
    return alpha, float(ratio), drift, transition.advantage


def test_functional_step_is_that_of_the_equation():
    """New centres are features of the drawn transitions, their weights (1 - 0.9) alpha_k; the old ones move on by v."""
    given = case("reskpn")
    features = np.array([reference.features(given.after, t.observation) for t in given.transitions])
    new_rows = slice(OLD_CENTRES, OLD_CENTRES + DRAWN)
    distance = np.linalg.norm(given.after["expansion/centres"][new_rows, None] - features[None], axis=2)
    drawn = distance.argmin(axis=1)
    np.testing.assert_allclose(distance.min(axis=1), 0.0, atol=1e-5)
    assert len(set(drawn)) == DRAWN
    found = [functional_gradient(given, given.transitions[k]) for k in drawn]
    alphas = np.array([alpha for alpha, *_ in found])
    # Those drawn have what the equation tells apart: ratios beyond the clip, drift for advantages of both signs.
    assert any(ratio > 2 for _, ratio, _, _ in found)
    assert any(drift > 0 and advantage > 0 for _, _, drift, advantage in found)
    assert any(drift > 0 and advantage < 0 for _, _, drift, advantage in found)
    velocity = MOMENTUM * given.before["momentum/velocity"]
    velocity[new_rows] = (1 - MOMENTUM) * alphas
    scale = np.abs(alphas).max()
    np.testing.assert_allclose(given.after["momentum/velocity"], velocity, atol=1e-4 * scale)
    np.testing.assert_allclose(
        given.after["expansion/weights"], given.before["expansion/weights"] + velocity, atol=1e-4 * scale, rtol=1e-6
    )
    np.testing.assert_array_equal(
        given.after["expansion/centres"][:OLD_CENTRES], given.before["expansion/centres"][:OLD_CENTRES]
    )
    assert given.after["momentum/added"] == OLD_CENTRES + DRAWN
    assert given.metrics["rkhs/centres"] == OLD_CENTRES + DRAWN
    np.testing.assert_allclose(given.metrics["rkhs/alpha"], np.linalg.norm(alphas), rtol=1e-3)


def test_effect_metrics():
    """What the update did to the policy: sizes of h and mu, and the KL that the functional step caused."""
    given = case("reskpn")
    h = {
        when: np.array(
            [
                reference.expansion(
                    arrays["expansion/centres"],
                    arrays["expansion/weights"],
                    reference.features(given.after, t.observation),
                    BANDWIDTH,
                )
                for t in given.transitions
            ]
        )
        for when, arrays in (("before", given.before), ("after", given.after))
    }
    residual = np.array([reference.residual(given.after, t.observation) for t in given.transitions])
    std = np.exp(given.after["policy/log_std"])
    targets = np.array([t.target for t in given.transitions])
    advantages = targets - np.array([t.value for t in given.transitions])
    expected = {
        "rkhs/h_rms": np.sqrt(np.mean(h["after"] ** 2)),
        "rkhs/residual_rms": np.sqrt(np.mean(residual**2)),
        "rkhs/step_kl": np.mean(np.sum(((h["after"] - h["before"]) / std) ** 2, axis=1) / 2),
        "policy/mean_rms": np.sqrt(np.mean((h["after"] + residual) ** 2)),
        "policy/std": std.mean(),
        "train/explained_variance": 1 - advantages.var() / targets.var(),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(given.metrics[name], value, rtol=1e-3, err_msg=name)


def test_the_divergence_from_the_policy_that_acted():
    """`policy/kl` is the mean of r - 1 - log r after networks and functional step together, over the batch."""
    given = case("reskpn")
    divergences = []
    for transition in given.transitions:
        mean, log_std = reference_policy(given.after, transition.observation)
        log_ratio = reference.log_prob(mean, log_std, transition.action) - transition.log_prob
        divergences.append(np.exp(log_ratio) - 1 - log_ratio)
    np.testing.assert_allclose(given.metrics["policy/kl"], np.mean(divergences), rtol=1e-3)
    assert given.metrics["policy/kl"] > 2 * given.metrics["rkhs/step_kl"]


def test_gradients_reach_the_features_through_h():
    """With mu = 0 the features learn through h alone: not at all while its weights are zero, and then they do."""
    learner = one_gradient_step("reskpn")
    batch = random_batch(learner, seed=2)
    no_residual = changed(
        in_the_middle(learner),
        parameters__policy__residual__kernel=0.0,
        parameters__policy__residual__bias=0.0,
        momentum__velocity=0.0,
    )
    features = [name for name in trees.to_arrays(no_residual) if name.startswith("parameters/policy/features/")]
    for state, learns in ((changed(no_residual, expansion__weights=0.0), False), (no_residual, True)):
        before = trees.to_arrays(state)
        after = trees.to_arrays(learner.step(state, batch)[0])
        assert [not np.array_equal(before[name], after[name]) for name in features] == [learns] * len(features)
        # Centres and weights are constants of the loss: without momentum nothing moves the old ones.
        for name in ("expansion/centres", "expansion/weights"):
            assert before[name][:OLD_CENTRES].tobytes() == after[name][:OLD_CENTRES].tobytes()
