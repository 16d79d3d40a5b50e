"""The policy as it acts."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import numpy_reference

from common.kernels.gaussian import Gaussian
from common.maths import expansion as expansions
from common.maths import policy, running, trees
from common.maths.expansion import Expansion
from common.maths.networks import make_networks
from common.maths.policy import Policy
from common.maths.rkhs.exact import Exact
from common.maths.running import Moments

BANDWIDTH = 0.5
OBSERVATION = jnp.array([[0.5, -1.0], [2.0, 0.25], [0.0, 0.0]])
CENTRES = jnp.array([[0.1, 0.2, 0.0, -0.1], [-0.3, 0.0, 0.2, 0.1]])
WEIGHTS = jnp.array([[1.0], [-2.0]])
MOMENTS = Moments(jnp.array([1.0, -1.0]), jnp.array([4.0, 0.25]), jnp.asarray(10.0))


@functools.cache
def networks_and_parameters() -> tuple:
    """Two tanh layers of 4, features of size d = 4, one action; no number of it zero."""
    networks, parameters = make_networks(2, 1, (4, 4), seed=0)
    return networks, jax.tree.map(lambda x: x + 0.05, parameters["policy"])


def act(expansion: Expansion, *, normalise: bool) -> policy.Mean:
    networks, parameters = networks_and_parameters()
    snapshot = Policy(parameters, expansion, MOMENTS)
    run = jax.jit(functools.partial(policy.act, networks, Exact(Gaussian(BANDWIDTH), 0), normalise=normalise))
    return run(snapshot, OBSERVATION)


def expected_parts(observation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features, h and mu by the equations."""
    arrays = trees.to_arrays({"policy": networks_and_parameters()[1]})
    features = np.array([numpy_reference.features(arrays, o) for o in observation])
    rkhs = [numpy_reference.expansion(np.asarray(CENTRES), np.asarray(WEIGHTS), z, BANDWIDTH) for z in features]
    residual = [numpy_reference.residual(arrays, o) for o in observation]
    return features, np.array(rkhs), np.array(residual)


def test_mean_is_h_plus_mu():
    """m(o) = h(z / sqrt(d)) + mu(z) with z = psi(o), against NumPy."""
    mean = act(Expansion(CENTRES, WEIGHTS), normalise=False)
    features, rkhs, residual = expected_parts(np.asarray(OBSERVATION))
    np.testing.assert_allclose(mean.features, features, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(mean.rkhs, rkhs, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(mean.residual, residual, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(mean.total, rkhs + residual, rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(mean.log_std, np.full(1, 0.05, np.float32))


def test_kernel_inputs_have_length_at_most_one():
    """tanh features divided by sqrt(d) lie in the unit ball, however large the observation."""
    networks, parameters = networks_and_parameters()
    mean = policy.evaluate(
        networks, Exact(Gaussian(BANDWIDTH), 0), parameters, Expansion(CENTRES, WEIGHTS), 1e3 * OBSERVATION
    )
    # Four components of at most 1, over sqrt(4).
    assert np.linalg.norm(mean.features, axis=1).max() <= 1.0 + 1e-6


def test_observations_are_whitened_where_the_run_normalises():
    """The mean at raw observations is that at (o - mean) / std."""
    mean = act(Expansion(CENTRES, WEIGHTS), normalise=True)
    # Standard deviations are 2 and 0.5.
    whitened = (np.asarray(OBSERVATION) - [1.0, -1.0]) / [2.0, 0.5]
    features, rkhs, residual = expected_parts(whitened)
    np.testing.assert_allclose(mean.features, features, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(mean.total, rkhs + residual, rtol=1e-4, atol=1e-6)


def test_acting_and_updating_see_the_same_numbers():
    """`act` on raw observations is `evaluate` on standardised ones, bit for bit."""
    networks, parameters = networks_and_parameters()
    expansion = Expansion(CENTRES, WEIGHTS)
    kernel = Exact(Gaussian(BANDWIDTH), CENTRES.shape[0])
    acted = policy.act(networks, kernel, Policy(parameters, expansion, MOMENTS), OBSERVATION, normalise=True)
    evaluated = policy.evaluate(networks, kernel, parameters, expansion, running.standardise(MOMENTS, OBSERVATION))
    for ours, theirs in zip(jax.tree.leaves(acted), jax.tree.leaves(evaluated), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_weights_of_zero_act_like_no_expansion():
    """A reskpn policy before its first functional step acts as ppo's: h = 0 adds nothing to any action."""
    unused, _ = expansions.empty(8, 4, 1)
    zero_weights = Expansion(CENTRES, jnp.zeros_like(WEIGHTS))
    none, _ = expansions.empty(0, 4, 1)
    ppo = act(none, normalise=True)
    for reskpn in (act(unused, normalise=True), act(zero_weights, normalise=True)):
        np.testing.assert_array_equal(reskpn.total, ppo.total)
        np.testing.assert_array_equal(reskpn.log_std, ppo.log_std)


def test_capacity_zero_computes_no_kernel():
    """Without room for centres the kernel is never called, and h is zero."""

    def never(*_: jax.Array) -> jax.Array:
        raise AssertionError("the kernel was evaluated")

    networks, parameters = networks_and_parameters()
    none, _ = expansions.empty(0, 4, 1)
    mean = policy.evaluate(networks, Exact(never, 0), parameters, none, OBSERVATION)
    np.testing.assert_array_equal(mean.rkhs, np.zeros((3, 1)))
