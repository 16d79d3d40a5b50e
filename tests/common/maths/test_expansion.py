"""The expansion h and its functional gradient step."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import numpy_reference
import pytest

from common.kernels.gaussian import Gaussian
from common.maths import expansion as expansions

BANDWIDTH = 0.5
CENTRES = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, -0.4], [0.3, 0.3]], np.float32)
ALPHAS = np.array([[1.0, -2.0], [3.0, 0.5], [-1.0, 1.0], [0.25, 4.0]], np.float32)
POINTS = np.array([[0.1, 0.2], [-0.3, 0.0], [0.5, -0.5]], np.float32)

step = jax.jit(expansions.step, static_argnames="decay")
evaluate = jax.jit(functools.partial(expansions.evaluate, kernel=Gaussian(BANDWIDTH)))


def h_at_points(expansion: expansions.Expansion) -> np.ndarray:
    return np.asarray(evaluate(expansion, features=jnp.asarray(POINTS)))


def kernel_at_points(centre: np.ndarray) -> np.ndarray:
    """K(c, .) at the points, as a column."""
    return np.array([[numpy_reference.gaussian(centre, point, BANDWIDTH)] for point in POINTS])


def terms(*factors: float) -> np.ndarray:
    """sum_k factor_k alpha_k K(c_k, .) at the points."""
    return sum(
        factor * ALPHAS[k] * kernel_at_points(CENTRES[k]) for k, factor in enumerate(factors) if factor
    ) + np.zeros((len(POINTS), 2))


def after(steps: int, *, capacity: int, decay: float, each: int = 1) -> tuple:
    """The expansion and its momentum after that many steps, each at the next `each` of the centres."""
    state = expansions.empty(capacity, 2, 2)
    for k in range(0, steps * each, each):
        state = step(*state, jnp.asarray(CENTRES[k : k + each]), jnp.asarray(ALPHAS[k : k + each]), decay=decay)
    return state


def test_evaluate_by_hand():
    """h(x) = sum_i w_i K(c_i, x)."""
    expansion = expansions.Expansion(jnp.asarray(CENTRES), jnp.asarray(ALPHAS))
    np.testing.assert_allclose(h_at_points(expansion), terms(1.0, 1.0, 1.0, 1.0), rtol=1e-5)


def test_empty_expansion_is_zero():
    """Room for centres is not yet a function: h = 0 everywhere, no centre in use."""
    expansion, momentum = expansions.empty(4, 2, 2)
    np.testing.assert_array_equal(h_at_points(expansion), np.zeros((3, 2)))
    assert expansions.size(expansion, momentum) == 0
    assert expansion.capacity == 4


def test_step_without_momentum_adds_alpha_times_kernel():
    """One step at one transition changes h by exactly alpha K(c, .), whatever was there before."""
    before, momentum = after(2, capacity=4, decay=0.0)
    new, _ = step(before, momentum, jnp.asarray(CENTRES[2:3]), jnp.asarray(ALPHAS[2:3]), decay=0.0)
    # Nothing of the first two moves: the new term is the whole change.
    np.testing.assert_array_equal(new.weights[:2], before.weights[:2])
    np.testing.assert_array_equal(new.weights[2], ALPHAS[2])
    np.testing.assert_array_equal(new.centres[2], CENTRES[2])
    np.testing.assert_allclose(h_at_points(new) - h_at_points(before), terms(0.0, 0.0, 1.0), rtol=1e-4, atol=1e-6)


def test_momentum_in_closed_form():
    """v <- 0.9 v + 0.1 g, h <- h + v over three steps."""
    # v_1 = 0.1 g_1;                          h_1 = 0.1 g_1
    # v_2 = 0.09 g_1 + 0.1 g_2;               h_2 = 0.19 g_1 + 0.1 g_2
    # v_3 = 0.081 g_1 + 0.09 g_2 + 0.1 g_3;   h_3 = 0.271 g_1 + 0.19 g_2 + 0.1 g_3
    expected = [(0.1,), (0.19, 0.1), (0.271, 0.19, 0.1)]
    velocities = [[0.1], [0.09, 0.1], [0.081, 0.09, 0.1]]
    for steps, (factors, velocity) in enumerate(zip(expected, velocities, strict=True), start=1):
        expansion, momentum = after(steps, capacity=4, decay=0.9)
        np.testing.assert_allclose(h_at_points(expansion), terms(*factors), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(momentum.velocity[:steps], np.array(velocity)[:, None] * ALPHAS[:steps], rtol=1e-5)


def test_momentum_carries_on_without_new_gradients():
    """A single gradient g moves h by g in all: 0.1 (1 + 0.9 + 0.81 + ...) = 1."""
    state = step(*expansions.empty(4, 2, 2), jnp.asarray(CENTRES[:1]), jnp.asarray(ALPHAS[:1]), decay=0.9)
    nothing = jnp.zeros((1, 2), jnp.float32)
    for _ in range(2):
        state = step(*state, jnp.asarray(CENTRES[1:2]), nothing, decay=0.9)
    # 0.1 (1 + 0.9 + 0.81) = 0.271 after three steps, the last two of them without a gradient.
    np.testing.assert_allclose(h_at_points(state[0]), terms(0.271), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("decay", "factors"), [(0.0, (0.0, 1.0, 1.0)), (0.9, (0.0, 0.19, 0.1))])
def test_full_expansion_gives_up_its_oldest_centre(decay, factors):
    """With room for two, the third centre takes the first one's place in h and in the moving average."""
    expansion, momentum = after(3, capacity=2, decay=decay)
    np.testing.assert_allclose(h_at_points(expansion), terms(*factors), rtol=1e-4, atol=1e-6)
    # Row 0 is the third centre's now, and its average starts anew: (1 - decay) alpha_3.
    np.testing.assert_array_equal(expansion.centres, CENTRES[[2, 1]])
    np.testing.assert_allclose(momentum.velocity[0], (1 - decay) * ALPHAS[2], rtol=1e-6)
    assert momentum.added == 3
    assert expansions.size(expansion, momentum) == 2


def test_several_centres_in_one_step():
    """Two centres a step in a room for three: the second step wraps around and gives up the oldest one only."""
    expansion, momentum = after(2, capacity=3, decay=0.0, each=2)
    # Rows: 1, 2, 3 and then 4 in the place of 1.
    np.testing.assert_array_equal(expansion.centres, CENTRES[[3, 1, 2]])
    np.testing.assert_allclose(h_at_points(expansion), terms(0.0, 1.0, 1.0, 1.0), rtol=1e-4, atol=1e-6)
    assert momentum.added == 4


def test_one_step_at_two_points_is_the_sum_of_both():
    """Without momentum a step at two transitions is two steps at one each."""
    together, _ = after(1, capacity=4, decay=0.0, each=2)
    apart, _ = after(2, capacity=4, decay=0.0)
    np.testing.assert_array_equal(together.weights, apart.weights)
    np.testing.assert_array_equal(together.centres, apart.centres)
