"""Ridge regression in two halves: weights, what held-out data make of them, and forgetting."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from common.maths.critic import ridge


def one_feature(x: list[list[float]], y: list[list[float]]) -> ridge.Equations:
    """The equations of y = theta x: a row of x and y for each half."""
    return ridge.equations(jnp.asarray(x, jnp.float32)[:, :, None], jnp.asarray(y, jnp.float32))


def test_weights_and_held_out_r2_by_hand() -> None:
    """Halves (x, y) = (1, 2) and (2, 2), penalty half the eigenvalue.

    A = 1, b = 2 gives theta = 2 / 1.5 = 4/3, which at x = 2 is off by 8/3 - 2 = 2/3; A = 4, b = 4 gives 4 / 6 = 2/3,
    off by 4/3 at x = 1. R^2 = 1 - (4/9 + 16/9) / (4 + 4) = 13/18. All: A = 5, b = 6, theta = 6 / 7.5.
    """
    given = one_feature([[1.0], [2.0]], [[2.0], [2.0]])
    np.testing.assert_allclose(ridge.held_out_r2(given, given, 0.5), 13 / 18, rtol=1e-6)
    np.testing.assert_allclose(ridge.solve(given.matrix.sum(0), given.right.sum(0), 0.5), [0.8], rtol=1e-6)


def test_the_penalty_is_relative_to_the_mean_eigenvalue() -> None:
    """A = diag(1, 3), b = (1, 3), ridge 0.5: lambda = 0.5 * (1 + 3) / 2 = 1, theta = (1 / 2, 3 / 4)."""
    matrix, right = jnp.diag(jnp.asarray([1.0, 3.0])), jnp.asarray([1.0, 3.0])
    np.testing.assert_allclose(ridge.solve(matrix, right, 0.5), [0.5, 0.75], rtol=1e-6)


def test_r2_is_negative_where_the_halves_contradict_each_other() -> None:
    """(1, 1) against (1, -1), hardly a penalty: each half predicts the other's opposite, R^2 = 1 - (4 + 4) / 2 = -3."""
    given = one_feature([[1.0], [1.0]], [[1.0], [-1.0]])
    np.testing.assert_allclose(ridge.held_out_r2(given, given, 1e-7), -3.0, rtol=1e-5)


def test_a_residual_of_zero_is_no_division_by_zero() -> None:
    """Nothing left to predict: R^2 is 0."""
    given = one_feature([[1.0], [1.0]], [[0.0], [0.0]])
    assert ridge.held_out_r2(given, given, 0.1) == 0.0


def test_forgetting_weighs_earlier_data_by_its_power() -> None:
    """y = 8, then 4, then 2 at x = 1, weight 1/2: b = 8/4 + 4/2 + 2 = 6 over A = 1/4 + 1/2 + 1 = 7/4 in each half."""
    total = ridge.no_equations(1)
    for y in (8.0, 4.0, 2.0):
        total = ridge.discounted_sum(total, one_feature([[1.0], [1.0]], [[y], [y]]), 0.5)
    np.testing.assert_allclose(total.right / total.matrix[:, :, 0], [[24 / 7], [24 / 7]], rtol=1e-6)
    np.testing.assert_allclose(ridge.solve(total.matrix.sum(0), total.right.sum(0), 1e-7), [24 / 7], rtol=1e-5)


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_without_earlier_data_forgetting_changes_nothing(weight: float) -> None:
    """The first batch alone, whatever the weight."""
    given = one_feature([[1.0], [2.0]], [[2.0], [2.0]])
    total = ridge.discounted_sum(ridge.no_equations(1), given, weight)
    np.testing.assert_array_equal(total.matrix, given.matrix)
    np.testing.assert_array_equal(total.right, given.right)
