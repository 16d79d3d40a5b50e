"""MuJoCo's JAX engine behind the same environment; one compilation for the whole file."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common.physics.environments import BatchedEnvironment, make_environment

N = 2


@pytest.fixture(scope="module")
def mjx() -> BatchedEnvironment:
    return make_environment("inverted_pendulum", "mjx", num_envs=N)


@pytest.fixture(scope="module")
def native() -> BatchedEnvironment:
    return make_environment("inverted_pendulum", "native", num_envs=N)


def test_both_engines_move_alike(mjx: BatchedEnvironment, native: BatchedEnvironment) -> None:
    """Ten steps (0.4 s) of the same actions from the same states: within 1e-3 of each other.

    The state of one engine is a state of the other. Rounding to float32 inside of MJX, and outside of C, is what
    differs; the pole falls by e every 0.2 s or so, so that 1e-6 has grown by some e^2 in the end.
    """
    start = native.reset(jax.random.key(0))
    ours = theirs = start
    for i in range(10):
        action = 0.1 * jax.random.uniform(jax.random.key(i), (N, 1), minval=-1)
        ours, by_native = native.step(ours, action)
        theirs, by_mjx = mjx.step(theirs, action)
        np.testing.assert_allclose(by_mjx.next_obs, by_native.next_obs, atol=1e-3)
        np.testing.assert_array_equal(by_mjx.reward, by_native.reward)
        np.testing.assert_array_equal(by_mjx.terminated, by_native.terminated)
    assert not np.array_equal(ours.obs, start.obs)


def test_a_step_is_compiled_once(mjx: BatchedEnvironment, native: BatchedEnvironment) -> None:
    """MJX makes weakly typed arrays when it starts; none of them gets out, for a compilation takes half a minute."""
    state = jax.eval_shape(mjx.reset, jax.random.key(0))
    after, _ = jax.eval_shape(mjx.step, state, jax.ShapeDtypeStruct((N, 1), jnp.float32))
    looks = [[(x.shape, x.dtype, x.weak_type) for x in jax.tree.leaves(tree)] for tree in (state, after)]
    assert looks[0] == looks[1]
    assert not any(weak for _, _, weak in looks[0])
    started = native.reset(jax.random.key(0))
    # Steps with a key, as another test makes them, are a program of their own.
    others = mjx._step._cache_size()
    once, _ = mjx.step(started, jnp.zeros((N, 1)))
    compiled = mjx._step._cache_size()
    assert compiled - others <= 1
    mjx.step(once, jnp.zeros((N, 1)))
    assert mjx._step._cache_size() == compiled


def test_a_simulation_that_diverged_is_ended_and_counted(mjx: BatchedEnvironment, native: BatchedEnvironment) -> None:
    """As with the native engine: ended with reward 0, restarted, counted."""
    start = native.reset(jax.random.key(0))
    bodies = dataclasses.replace(start.bodies, qd=start.bodies.qd.at[1, 0].set(jnp.nan))
    after, transition = mjx.step(dataclasses.replace(start, bodies=bodies), jnp.zeros((N, 1)))
    np.testing.assert_array_equal(after.diverged, [0, 1])
    np.testing.assert_array_equal(transition.terminated, [False, True])
    np.testing.assert_array_equal(transition.reward, [1, 0])
    np.testing.assert_array_equal(transition.obs[1], start.obs[1])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after, transition)))


def test_new_initial_states_are_those_of_the_native_engine(mjx: BatchedEnvironment, native: BatchedEnvironment) -> None:
    """Drawn with the same key, up to rounding, for the environment whose episode ended."""
    start = native.reset(jax.random.key(0))
    bodies = dataclasses.replace(start.bodies, qd=start.bodies.qd.at[1, 0].set(jnp.nan))
    after, transition = mjx.step(dataclasses.replace(start, bodies=bodies), jnp.zeros((N, 1)), jax.random.key(5))
    drawn = native.reset(jax.random.key(5))
    np.testing.assert_array_equal(transition.terminated, [False, True])
    np.testing.assert_allclose(transition.obs[1], drawn.obs[1], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(after.bodies.q[1], drawn.bodies.q[1], rtol=1e-5, atol=1e-6)


def test_time_in_physics_cannot_be_told(mjx: BatchedEnvironment) -> None:
    """XLA compiles physics into one program with the rest."""
    assert mjx.physics == "mjx"
    assert mjx.physics_seconds() is None
