"""The update as a function: what it depends on, what it does with every transition, what it compiles."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import numpy_reference as reference
import optax
from small_learners import (
    CAPACITY,
    DRAWN,
    ENVS,
    EPOCHS,
    MINIBATCHES,
    STEPS,
    changed,
    probe_learner,
    random_batch,
    same_bits,
)
from update_cases import double, one_gradient_step, with_ratios

from common.maths import trees


def test_without_centres_reskpn_is_ppo():
    """With capacity 0 the updates of reskpn and ppo are the same, bit for bit, metrics too, three times over."""
    reskpn, ppo = probe_learner("reskpn", capacity=0), probe_learner("ppo")
    ours, theirs = reskpn.start, ppo.start
    for seed in range(3):
        batch = random_batch(ppo, seed)
        ours, our_metrics = reskpn.step(ours, batch)
        theirs, their_metrics = ppo.step(theirs, batch)
        assert same_bits(trees.to_arrays(ours), trees.to_arrays(theirs))
        assert same_bits(trees.to_arrays(our_metrics), trees.to_arrays(their_metrics))
    assert not np.array_equal(ours.parameters["policy"]["log_std"], ppo.start.parameters["policy"]["log_std"])


def test_without_a_step_reskpn_is_ppo():
    """With centres but eta = 0, h stays 0 and nothing comes from it: parameters as ppo's, bit for bit, twice over."""
    reskpn, ppo = one_gradient_step("reskpn", eta=0.0), one_gradient_step("ppo")
    ours, theirs = reskpn.start, ppo.start
    for seed in range(2):
        batch = random_batch(ppo, seed)
        ours, _ = reskpn.step(ours, batch)
        theirs, _ = ppo.step(theirs, batch)
        for part in ("parameters", "optimiser", "observations", "returns"):
            left, right = (trees.to_arrays(vars(state)[part]) for state in (ours, theirs))
            assert same_bits(left, right), part
    assert ours.expansion.capacity > 0
    np.testing.assert_array_equal(ours.expansion.weights, 0.0)


def test_update_is_a_function_of_state_and_batch():
    """The same update twice gives the same bits; another version or another key draws other minibatches."""
    learner = probe_learner("ppo")
    batch = random_batch(learner, seed=0)
    once, again, later, other = (
        trees.to_arrays(learner.step(state, batch)[0].parameters)
        for state in (
            learner.start,
            learner.start,
            changed(learner.start, version=1),
            changed(learner.start, key=np.array([1, 2])),
        )
    )
    assert same_bits(once, again)
    assert not same_bits(once, later)
    assert not same_bits(once, other)


def test_every_pass_uses_every_transition_once():
    """Epochs times minibatches steps of Adam, and every pass is a partition of the batch.

    All transitions are clipped, so that the policy stays put and the mean of "kl" over the minibatches is the mean
    over the batch; were one left out or used twice, it would be another, as all ratios differ.
    """
    learner = probe_learner("ppo")
    # V = 0 and rewards of +-100 in episodes of one step: advantages are +-100, and normalising a minibatch keeps
    # their signs. r > 1.2 where A > 0 and r < 0.8 where A < 0 is clipped.
    critic = {name: 0.0 for name in trees.to_arrays(learner.start) if name.startswith("parameters/critic/value")}
    state = changed(learner.start, **critic)
    number = np.arange(STEPS * ENVS).reshape(STEPS, ENVS)
    positive = number % 2 == 0
    ratio = np.where(positive, 1.3 + 0.001 * number, 0.7 - 0.001 * number)
    batch = replace(
        random_batch(learner, seed=0, ends=False),
        reward=jnp.asarray(np.where(positive, 100.0, -100.0), jnp.float32),
        terminated=jnp.ones((STEPS, ENVS), jnp.bool_),
    )
    new, metrics = learner.step(state, with_ratios(learner, state, batch, np.log(ratio)))
    assert same_bits(trees.to_arrays(new.parameters["policy"]), trees.to_arrays(state.parameters["policy"]))
    np.testing.assert_allclose(metrics["train/kl"], np.mean(ratio - 1 - np.log(ratio)), rtol=1e-4)
    assert metrics["train/clip_fraction"] == 1.0
    assert optax.tree.get(new.optimiser, "count") == EPOCHS * MINIBATCHES


def test_drawn_transitions_are_of_the_batch_and_vary():
    """Every update draws n different transitions of its batch; over updates other ones."""
    learner = probe_learner("reskpn")
    batch = random_batch(learner, seed=0)
    observations = np.asarray(batch.obs, np.float64).reshape(-1, 1)
    drawn = []
    for version in range(2):
        after = double(trees.to_arrays(learner.step(changed(learner.start, version=version), batch)[0]))
        features = np.array([reference.features(after, o) for o in observations])
        distance = np.linalg.norm(after["expansion/centres"][:DRAWN, None] - features[None], axis=2)
        np.testing.assert_allclose(distance.min(axis=1), 0.0, atol=1e-5)
        drawn.append(set(distance.argmin(axis=1)))
        assert len(drawn[-1]) == DRAWN
    assert drawn[0] != drawn[1]


def test_growth_does_not_recompile():
    """An empty expansion, one that becomes full and one that evicts are served by one compiled program."""
    learner = probe_learner("reskpn")
    batch = random_batch(learner, seed=0)
    state, metrics = learner.step(learner.start, batch)
    assert metrics["rkhs/centres"] == DRAWN
    state = changed(state, momentum__added=CAPACITY - 2 * DRAWN)
    compiled = []

    def count(event: str, _seconds: float, **_: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(count)
    try:
        sizes = []
        for _ in range(4):
            state, metrics = learner.step(state, batch)
            sizes.append(float(metrics["rkhs/centres"]))
        during = len(compiled)
        jax.jit(lambda x: x * 3.0)(1.0)
    finally:
        jax.monitoring.unregister_event_duration_listener(count)
    assert during == 0
    assert len(compiled) == 1  # the count does see a compilation
    assert sizes == [CAPACITY - DRAWN, CAPACITY, CAPACITY, CAPACITY]
    assert state.representation_state.added == CAPACITY + 2 * DRAWN


def test_metrics_are_float32_scalars():
    """Every metric is one float32 number, whichever the learner."""
    for learner in (one_gradient_step("reskpn"), one_gradient_step("dpo")):
        _, metrics = learner.step(learner.start, random_batch(learner, seed=2))
        assert {(value.shape, value.dtype) for value in metrics.values()} == {((), np.dtype(np.float32))}
