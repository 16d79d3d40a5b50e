"""Symmetric estimation through the whole update, against equations worked out in float64."""

import numpy as np
import numpy_reference as reference
import pytest
from update_cases import (
    DRIFT_ALPHA,
    DRIFT_BETA,
    ETA,
    GAMMA,
    MOMENTUM,
    OLD_CENTRES,
    case,
    reference_moments,
    reference_policy,
    whitened,
)

PAIRS = 4


def test_a_pair_moves_h_by_the_mean_of_its_two_actions():
    """Centres are the last states; alpha = eta / n times the mean over both actions of rho S^-1 (a - m) (A - D).

    A is r + gamma V(o') - V(o) with the critic as it stood, normalised over the eight actions.
    """
    given = case("reskpn", "symmetric")
    batch, before = given.batch, given.before
    assert (bool(batch.mirror_terminated.any()), bool(batch.mirror_truncated.any())) == (True, True)
    moments, reward = reference_moments(before, batch)
    mirror_reward = np.asarray(batch.mirror_reward, np.float64) / np.sqrt(moments["returns/variance"])
    inputs = whitened(given.learner, before, batch)
    observation = inputs.obs[-1]
    value = np.array([reference.value(before, o) for o in observation])

    def one_step(reward, next_observation, terminated):
        after = np.array([reference.value(before, o) for o in next_observation])
        return reward + GAMMA * np.where(terminated, 0.0, after) - value

    ended_at = np.where(np.asarray(batch.truncated[-1])[:, None], inputs.truncated_obs, inputs.last_obs)
    advantage = np.stack(
        [
            one_step(reward[-1], ended_at, np.asarray(batch.terminated[-1])),
            one_step(mirror_reward, inputs.mirror_obs, np.asarray(batch.mirror_terminated)),
        ]
    )
    advantage = (advantage - advantage.mean()) / advantage.std()
    arrays = {**given.after, **{key: before[key] for key in ("expansion/centres", "expansion/weights")}}
    alphas = np.zeros((PAIRS, 2))
    for gains, actions in zip(advantage, (batch.action[-1], batch.mirror_action), strict=True):
        for k in range(PAIRS):
            action = np.asarray(actions[k], np.float64)
            mean, log_std = reference_policy(arrays, observation[k])
            ratio = np.exp(reference.log_prob(mean, log_std, action) - float(batch.log_prob[-1, k]))
            drift = reference.drift(ratio, gains[k], DRIFT_ALPHA, DRIFT_BETA)
            score = (action - mean) / np.exp(log_std) ** 2
            alphas[k] += 0.5 * ETA / PAIRS * min(ratio, min(max(ratio, 0.0), 2.0)) * score * (gains[k] - drift)
    new_rows = slice(OLD_CENTRES, OLD_CENTRES + PAIRS)
    features = np.array([reference.features(given.after, o) for o in observation])
    np.testing.assert_allclose(given.after["expansion/centres"][new_rows], features, atol=1e-5)
    np.testing.assert_allclose(
        given.after["momentum/velocity"][new_rows], (1 - MOMENTUM) * alphas, atol=1e-4 * np.abs(alphas).max()
    )
    assert given.metrics["rkhs/centres"] == OLD_CENTRES + PAIRS


def test_the_networks_do_not_see_the_pairs():
    """Critic, features and log_std train on the batch alone, whatever the functional gradient is taken from."""
    given, other = case("reskpn", "symmetric"), case("reskpn")
    for name, value in given.after.items():
        if name.startswith(("policy/", "critic/", "observations/", "returns/")):
            np.testing.assert_array_equal(value, other.after[name], err_msg=name)
    assert given.metrics["rkhs/alpha"] != pytest.approx(other.metrics["rkhs/alpha"])
