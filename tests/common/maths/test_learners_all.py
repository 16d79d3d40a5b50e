"""The eight learners: what each is made of, what each trains, and what its functional gradient is weighed by."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from small_learners import SmallLearner, random_batch, small_learner

from common.config.settings import RunSettings
from common.learners import LEARNERS
from common.maths import policy, trees
from common.maths.samples import Samples


def learner(name: str) -> SmallLearner:
    settings = RunSettings.model_validate(
        {
            "learner": name,
            "num_envs": 16,
            "num_steps": 4,
            "actors": 1,
            "total_steps": 64 * 8,
            "algorithm": {"hidden": (8, 8), "minibatches": 4, "epochs": 1},
        }
    )
    return small_learner(settings, 3, 2)


TABLE = {
    # name: psi, h, heads, target, objective -- the table of the project's definition of the algorithm
    "origin-kernel": (False, True, "none", "Q", "none"),
    "kpn": (True, True, "none", "Q", "ppo"),
    "advkpn": (True, True, "none", "A", "ppo"),
    "reskpn": (True, True, "head", "A", "ppo"),
    "ppo": (True, False, "head", "A", "ppo"),
    "dpo": (True, False, "head", "A", "dpo"),
    "ppo-res": (True, False, "two heads", "A", "ppo"),
    "dpo-res": (True, False, "two heads", "A", "dpo"),
}


def test_the_table_of_switches() -> None:
    """Eight learners, each with the switches of its definition."""
    built = {name: (row.features, row.rkhs, row.residual, row.target, row.objective) for name, row in LEARNERS.items()}
    assert built == TABLE


@pytest.mark.parametrize("name", ["origin-kernel", "kpn", "dpo-res"])  # one with each part that others lack
def test_a_learner_trains_what_it_has(name: str) -> None:
    """After two updates all its parameters have moved, h where there is one, and every number is finite."""
    small = learner(name)
    first, _ = small.step(small.start, random_batch(small, 0))
    state, metrics = small.step(first, random_batch(small, 1))
    before, after = trees.to_arrays(small.start), trees.to_arrays(state)
    moved = {path for path in before if not np.array_equal(before[path], after[path])}
    features, rkhs, residual, _, _ = TABLE[name]
    layers = {path for path in before if path.startswith("parameters/policy/features")}
    heads = {path for path in before if path.startswith("parameters/policy/residual")}
    assert len(layers) == (4 if features else 0)
    assert len(heads) == {"none": 0, "head": 2, "two heads": 4}[residual]
    assert layers | heads | {"parameters/policy/log_std", "parameters/critic/value/kernel"} <= moved
    assert ("expansion/weights" in moved) is rkhs
    assert all(value == 1.0 for key, value in metrics.items() if key.startswith("finite/"))


def test_without_features_the_kernel_sees_observations() -> None:
    """The centre of origin-kernel is an observation as it was seen: standardised by what was seen up to its step."""
    small = learner("origin-kernel")
    batch = random_batch(small, 0)
    state, _ = small.step(small.start, batch)
    centre = np.asarray(state.expansion.centres[0])
    steps = np.asarray(batch.obs, np.float64)
    so_far = [steps[: t + 1].reshape(-1, 3) for t in range(len(steps))]
    # The prior weighs as 1e-4 of an observation, beside 16 in the first step.
    seen = [(steps[t] - values.mean(axis=0)) / values.std(axis=0) for t, values in enumerate(so_far)]
    assert np.abs(np.concatenate(seen) - centre).sum(axis=1).min() < 1e-3


def test_q_learners_weigh_by_the_lambda_return_and_a_learners_by_the_normalised_advantage() -> None:
    """The coefficients of one transition with G = A + V and with G = (A - mean)/std are in that proportion.

    Both with drift 0: at ratio 1 there is none.
    """
    samples = Samples(
        obs=jnp.zeros((2, 3), jnp.float32),
        action=jnp.ones((2, 2), jnp.float32),
        log_prob=jnp.zeros(2, jnp.float32),
        value=jnp.asarray([10.0, 20.0], jnp.float32),
        advantage=jnp.asarray([1.0, 3.0], jnp.float32),
    )
    # A + V = 11, 23. A has mean 2 and standard deviation 1: -1, 1.
    np.testing.assert_allclose(learner("kpn").update.step.gain(samples), [11.0, 23.0])
    np.testing.assert_allclose(learner("advkpn").update.step.gain(samples), [-1.0, 1.0], rtol=1e-6)


def test_origin_kernel_trains_log_std_by_the_clip() -> None:
    """With nothing else to train, one update of log_std is that of kpn before its features and h move."""
    ours, kpn = learner("origin-kernel"), learner("kpn")
    # h = 0 in both at the start, so the mean is 0 and the first minibatch gives log_std the same gradient. Adam's first
    # step is 3e-4 in the direction of the gradient's sign; four minibatches of one epoch follow.
    batch = random_batch(ours, 3)
    left = trees.to_arrays(ours.step(ours.start, batch)[0])["parameters/policy/log_std"]
    right = trees.to_arrays(kpn.step(kpn.start, batch)[0])["parameters/policy/log_std"]
    assert 0 < np.abs(left).max() <= 4 * 3.1e-4
    # h = 0 keeps kpn's mean at 0 through the first update too, whatever its features do.
    np.testing.assert_allclose(left, right, rtol=1e-3)


def test_the_second_head_adds_to_the_first() -> None:
    """dpo-res starts from dpo's features; its mean is the sum of two heads."""
    ours, dpo = learner("dpo-res"), learner("dpo")
    ours_arrays, dpo_arrays = trees.to_arrays(ours.start), trees.to_arrays(dpo.start)
    for name in ("kernel", "bias"):
        path = f"parameters/policy/features/layers/0/{name}"
        np.testing.assert_array_equal(ours_arrays[path], dpo_arrays[path])
    observation = random_batch(ours, 0).obs[0]
    mean = policy.evaluate(
        ours.networks,
        ours.update.representation,
        ours.start.parameters["policy"],
        ours.start.expansion,
        observation,
    )
    z = np.asarray(mean.features) * np.sqrt(8)
    heads = [ours_arrays[f"parameters/policy/residual/{name}/kernel"] for name in ("head", "second")]
    assert not np.array_equal(*heads)
    np.testing.assert_allclose(mean.residual, z @ heads[0] + z @ heads[1], atol=1e-5)
