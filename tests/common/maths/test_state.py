"""The state before the first update, and the optimiser."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from small_learners import same_bits

from common.config.settings import AlgorithmSettings
from common.kernels.gaussian import Gaussian
from common.maths import trees
from common.maths.networks import make_networks
from common.maths.rkhs.exact import Exact
from common.maths.state import LearnerState, initial_state, make_optimiser

ALGORITHM = AlgorithmSettings(hidden=(4,), learning_rate=0.1, adam_eps=1e-5, max_grad_norm=0.5)


def start(seed: int = 0, capacity: int = 6) -> LearnerState:
    networks, parameters = make_networks(3, 2, ALGORITHM.hidden, seed=0)
    return initial_state(
        networks,
        parameters,
        ALGORITHM,
        representation=Exact(Gaussian(0.5), capacity),
        slots=5,
        envs_per_slot=7,
        seed=seed,
    )


def test_initial_state():
    """h = 0, nothing observed, nothing earned, version 0."""
    arrays = trees.to_arrays(start())
    assert arrays["expansion/centres"].shape == (6, 4)
    assert arrays["expansion/weights"].shape == arrays["momentum/velocity"].shape == (6, 2)
    assert arrays["discounted"].shape == (5, 7)
    zero = ["expansion/centres", "expansion/weights", "momentum/velocity", "momentum/added", "discounted", "version"]
    assert all(not arrays[name].any() for name in zero)
    for name, shape in (("observations", (3,)), ("returns", ())):
        np.testing.assert_array_equal(arrays[f"{name}/mean"], np.zeros(shape))
        np.testing.assert_array_equal(arrays[f"{name}/variance"], np.ones(shape))
    assert not any(arrays[name].any() for name in arrays if name.startswith("optimiser"))


def test_key_is_a_function_of_the_seed():
    """Draws of the updates come from a key of their own: another for every seed, and not the networks' key."""
    keys = [tuple(np.asarray(start(seed).key)) for seed in (0, 0, 1)]
    assert keys[0] == keys[1] != keys[2]
    assert keys[0] != tuple(np.asarray(jax.random.key_data(jax.random.key(0))))


def test_policy_is_what_acting_needs():
    """A snapshot is parameters of the policy, the expansion and the observations' moments, and nothing else."""
    state = start()
    snapshot = trees.to_arrays(state.policy)
    arrays = trees.to_arrays(state)
    expected = {
        name.replace("parameters/policy/", "parameters/"): array
        for name, array in arrays.items()
        if name.startswith(("parameters/policy/", "expansion/", "observations/"))
    }
    assert same_bits(snapshot, expected)


def test_without_room_the_expansion_has_no_rows():
    """Capacity 0 is an expansion without centres, not a special case of the state."""
    arrays = trees.to_arrays(start(capacity=0))
    assert arrays["expansion/centres"].shape == (0, 4)
    assert arrays["momentum/velocity"].shape == (0, 2)


@pytest.mark.parametrize("length", [5.0, 0.25])
def test_first_step_of_adam_by_hand(length):
    """The gradient's global norm is held at 0.5; Adam's first step is the learning rate times g / (|g| + eps)."""
    optimiser = make_optimiser(ALGORITHM)
    parameters = {"a": jnp.zeros(1), "b": jnp.zeros(1)}
    # Norm 5 or 0.25 along (0.6, 0.8); beyond 0.5 it is scaled to 0.5 over all arrays together.
    held = min(length, 0.5)
    gradient = {"a": jnp.array([0.6 * length]), "b": jnp.array([-0.8 * length])}
    updates, state = optimiser.update(gradient, optimiser.init(parameters), parameters)
    # After one step the corrected averages are g and g^2, so the step is -0.1 g / (|g| + 1e-5).
    for name, g in (("a", 0.6 * held), ("b", -0.8 * held)):
        np.testing.assert_allclose(updates[name], [-0.1 * g / (abs(g) + 1e-5)], rtol=1e-5)
    # The averages themselves: 0.1 g and 0.001 g^2.
    np.testing.assert_allclose(optax.tree.get(state, "mu")["a"], [0.1 * 0.6 * held], rtol=1e-5)
    np.testing.assert_allclose(optax.tree.get(state, "nu")["b"], [0.001 * (0.8 * held) ** 2], rtol=1e-4)
