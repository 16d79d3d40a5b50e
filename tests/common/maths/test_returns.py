"""Advantages and discounted returns against slow loops and by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import numpy_reference
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from common.maths import returns

STEPS, ENVS, SLOTS, ROLLOUTS = 5, 3, 2, 4

numbers = nps.arrays(np.float64, (STEPS, ENVS), elements=st.floats(-10, 10))
ends = nps.arrays(np.int8, (STEPS, ENVS), elements=st.integers(0, 5))
advantage = jax.jit(returns.generalised_advantage, static_argnames=("gamma", "lambda_"))
discounted = jax.jit(returns.discounted_returns, static_argnames="gamma")


@given(numbers, numbers, numbers, ends)
@settings(max_examples=60)
def test_advantage_is_the_sum_of_later_deltas(reward, value, next_value, end):
    """The backward scan gives what a double loop over later steps gives, whatever ends where."""
    terminated, truncated = end == 1, end == 2
    arguments = (reward, value, next_value, terminated, truncated)
    with jax.enable_x64(True):
        given = advantage(*map(jnp.asarray, arguments), gamma=0.9, lambda_=0.8)
    expected = numpy_reference.generalised_advantage(*arguments, 0.9, 0.8)
    np.testing.assert_allclose(given, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("terminated", "truncated", "expected"),
    [
        # gamma = 0.5, lambda = 0.5; r = 1, 2; V = 1, 2; next values 2, 4.
        # No end: delta_1 = 2 + 0.5 * 4 - 2 = 2; delta_0 = 1 + 0.5 * 2 - 1 = 1; A_0 = 1 + 0.25 * 2 = 1.5.
        ([False, False], [False, False], [1.5, 2.0]),
        # Terminated at 0: no bootstrap and nothing of step 1: 1 - 1 = 0.
        ([True, False], [False, False], [0.0, 2.0]),
        # Truncated at 0: the bootstrap that was passed stays, step 1 is another episode: delta_0 = 1.
        ([False, False], [True, False], [1.0, 2.0]),
        # Terminated at 1: delta_1 = 2 - 2 = 0; A_0 = delta_0 = 1.
        ([False, True], [False, False], [1.0, 0.0]),
    ],
)
def test_advantage_by_hand(terminated, truncated, expected):
    """Termination takes the bootstrap away, truncation does not; neither lets the next episode in."""
    given = advantage(
        jnp.array([[1.0], [2.0]]),
        jnp.array([[1.0], [2.0]]),
        jnp.array([[2.0], [4.0]]),
        jnp.array(terminated)[:, None],
        jnp.array(truncated)[:, None],
        gamma=0.5,
        lambda_=0.5,
    )
    np.testing.assert_allclose(given[:, 0], expected, rtol=1e-6)


def test_truncation_without_bootstrap():
    """Passing zero as the next value at a truncation makes it count as an end without a future."""
    reward, value = jnp.array([[1.0]]), jnp.array([[3.0]])
    no, yes = jnp.array([[False]]), jnp.array([[True]])
    # 1 + 0.9 * 10 - 3 = 7 with the value of the state at the cut, 1 + 0.9 * 0 - 3 = -2 without.
    for next_value, expected in ((10.0, 7.0), (0.0, -2.0)):
        given = advantage(reward, value, jnp.array([[next_value]]), no, yes, gamma=0.9, lambda_=0.95)
        np.testing.assert_allclose(given, [[expected]], rtol=1e-6)


def test_lambda_one_and_zero():
    """lambda 1 is the discounted return less the value; lambda 0 the one-step error."""
    reward, value = jnp.array([[1.0], [1.0], [1.0]]), jnp.array([[0.5], [0.5], [0.5]])
    next_value = jnp.array([[0.5], [0.5], [8.0]])
    no = jnp.zeros((3, 1), jnp.bool_)
    # Return of step 0: 1 + 0.5 + 0.25 + 0.125 * 8 = 2.75; of step 1: 1 + 0.5 + 0.25 * 8 = 3.5; of step 2: 1 + 4 = 5.
    # One-step errors: 1 + 0.5 * 0.5 - 0.5 = 0.75 twice, then 1 + 4 - 0.5 = 4.5.
    for lambda_, expected in ((1.0, [2.25, 3.0, 4.5]), (0.0, [0.75, 0.75, 4.5])):
        given = advantage(reward, value, next_value, no, no, gamma=0.5, lambda_=lambda_)
        np.testing.assert_allclose(given[:, 0], expected, rtol=1e-6)


rollouts = nps.arrays(np.float64, (ROLLOUTS, STEPS, ENVS), elements=st.floats(-10, 10))
dones = nps.arrays(np.bool_, (ROLLOUTS, STEPS, ENVS))
slots = nps.arrays(np.int32, (ROLLOUTS,), elements=st.integers(0, SLOTS - 1))
freshness = nps.arrays(np.bool_, (ROLLOUTS,))
carries = nps.arrays(np.float64, (SLOTS, ENVS), elements=st.floats(-10, 10))


@given(carries, slots, freshness, rollouts, dones)
@settings(max_examples=60)
def test_discounted_returns_are_those_of_a_loop(carried, slot, fresh, reward, done):
    """Any order of slots, with several rollouts of one slot and fresh environments among them."""
    arguments = (carried, slot, fresh, reward, done)
    with jax.enable_x64(True):
        given = discounted(*map(jnp.asarray, arguments), gamma=0.9)
    for ours, expected in zip(given, numpy_reference.discounted_returns(*arguments, 0.9), strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_two_rollouts_of_one_slot_follow_one_another():
    """The second rollout of a slot goes on where the first one ended; a fresh one starts at zero."""
    carried = jnp.array([[8.0], [4.0]])
    reward = jnp.ones((3, 1, 1))
    done = jnp.zeros((3, 1, 1), jnp.bool_)
    # gamma = 0.5. Slot 0: 0.5 * 8 + 1 = 5, then 0.5 * 5 + 1 = 3.5. Slot 1 is fresh: 0.5 * 0 + 1 = 1.
    after, every = discounted(carried, jnp.array([0, 0, 1]), jnp.array([False, False, True]), reward, done, gamma=0.5)
    np.testing.assert_array_equal(every[:, 0, 0], [5.0, 3.5, 1.0])
    np.testing.assert_array_equal(after, [[3.5], [1.0]])


def test_an_end_forgets_what_came_before():
    """Where an episode ends, the return is that step's reward alone, and later steps build on it."""
    after, every = discounted(
        jnp.array([[8.0]]),
        jnp.array([0]),
        jnp.array([False]),
        jnp.array([[[1.0], [2.0], [3.0]]]),
        jnp.array([[[False], [True], [False]]]),
        gamma=0.5,
    )
    # 0.5 * 8 + 1 = 5; the end: 2; 0.5 * 2 + 3 = 4.
    np.testing.assert_array_equal(every[0, :, 0], [5.0, 2.0, 4.0])
    np.testing.assert_array_equal(after, [[4.0]])
