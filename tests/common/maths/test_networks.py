"""Networks: what they start from and what they compute."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy_reference import value as reference_value

from common.maths import trees
from common.maths.networks import make_networks

OBSERVATION, ACTION, HIDDEN = 3, 2, (8, 4)


@functools.cache
def made(
    observation: int = OBSERVATION, action: int = ACTION, hidden: tuple[int, ...] = HIDDEN, seed: int = 0
) -> tuple:
    networks, parameters = make_networks(observation, action, hidden, seed)
    return networks, parameters, trees.to_arrays(parameters)


def test_sizes():
    """The layers' sizes are those asked for; the feature size is the last hidden width."""
    networks, _, arrays = made()
    assert {name: array.shape for name, array in arrays.items()} == {
        "policy/features/layers/0/kernel": (3, 8),
        "policy/features/layers/0/bias": (8,),
        "policy/features/layers/1/kernel": (8, 4),
        "policy/features/layers/1/bias": (4,),
        "policy/residual/kernel": (4, 2),
        "policy/residual/bias": (2,),
        "policy/log_std": (2,),
        "critic/features/layers/0/kernel": (3, 8),
        "critic/features/layers/0/bias": (8,),
        "critic/features/layers/1/kernel": (8, 4),
        "critic/features/layers/1/bias": (4,),
        "critic/value/kernel": (4, 1),
        "critic/value/bias": (1,),
    }
    assert (networks.observation_size, networks.action_size, networks.feature_size) == (3, 2, 4)
    assert {array.dtype for array in arrays.values()} == {np.dtype(np.float32)}


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("policy/features/layers/0/kernel", np.sqrt(2)),
        ("policy/features/layers/1/kernel", np.sqrt(2)),
        ("policy/residual/kernel", 0.01),
        ("critic/features/layers/0/kernel", np.sqrt(2)),
        ("critic/features/layers/1/kernel", np.sqrt(2)),
        ("critic/value/kernel", 1.0),
    ],
)
def test_kernels_start_orthogonal(name, scale):
    """The shorter side of every kernel is an orthogonal set of vectors of length `scale`."""
    kernel = made()[2][name].astype(np.float64)
    short = kernel if kernel.shape[0] <= kernel.shape[1] else kernel.T
    np.testing.assert_allclose(short @ short.T, scale**2 * np.eye(len(short)), atol=1e-6 * scale**2)


def test_biases_and_log_std_start_at_zero():
    """Every bias is zero and every standard deviation 1."""
    arrays = made()[2]
    zeros = [name for name in arrays if name.endswith(("bias", "log_std"))]
    assert len(zeros) == 7
    assert all(not arrays[name].any() for name in zeros)


def test_same_seed_same_parameters():
    """Parameters are a function of sizes and seed."""
    again = trees.to_arrays(make_networks(OBSERVATION, ACTION, HIDDEN, 0)[1])
    other = made(seed=1)[2]
    for name, array in made()[2].items():
        np.testing.assert_array_equal(array, again[name])
    for name in ("policy/features/layers/0/kernel", "policy/residual/kernel", "critic/value/kernel"):
        assert not np.array_equal(made()[2][name], other[name])


def test_critic_does_not_depend_on_the_policy():
    """Another action size changes the residual layer, and neither the features nor the critic."""
    here, there = made()[2], made(action=5)[2]
    same = [name for name in here if not name.startswith(("policy/residual", "policy/log_std"))]
    for name in same:
        np.testing.assert_array_equal(here[name], there[name])


def test_policy_and_critic_start_from_different_features():
    """Both towers have the same sizes but not the same numbers."""
    arrays = made()[2]
    assert not np.array_equal(arrays["policy/features/layers/0/kernel"], arrays["critic/features/layers/0/kernel"])


def test_value_is_two_tanh_layers_and_a_linear_one():
    """V(o) against NumPy, with biases that are not zero."""
    networks, parameters, _ = made()
    moved = jax.tree.map(lambda x: x + 0.1, parameters)
    observation = np.random.default_rng(0).standard_normal((5, OBSERVATION)).astype(np.float32)
    expected = [reference_value(trees.to_arrays(moved), o) for o in observation]
    np.testing.assert_allclose(networks.value(moved["critic"], jnp.asarray(observation)), expected, rtol=1e-4)


def test_bound_policy_has_the_parameters_given():
    """Binding puts parameters into a network without changing them or the parameters bound before."""
    networks, parameters, arrays = made()
    networks.bind_policy(jax.tree.map(lambda x: x + 1.0, parameters["policy"]))
    bound = networks.bind_policy(parameters["policy"])
    np.testing.assert_array_equal(bound.log_std[...], arrays["policy/log_std"])
    np.testing.assert_array_equal(bound.residual.kernel[...], arrays["policy/residual/kernel"])
