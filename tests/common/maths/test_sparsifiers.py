"""Clustering and kernel matching pursuit: fewer centres, and how far h may be from what it would have been."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from functions import as_dtype, gaussian_sum, points, rkhs_norm, stepped, value

from common.kernels.gaussian import Gaussian
from common.maths.rkhs.clustering import Cluster
from common.maths.rkhs.exact import Exact
from common.maths.rkhs.matching_pursuit import KernelMatchingPursuit

WIDTH = 2.0
KERNEL = Gaussian(WIDTH)
ELSEWHERE = points(10, 2, seed=2)


def test_clustering_at_radius_zero_is_exact() -> None:
    """Five steps of three transitions into room for seven, some of them twice: the same arrays, bit for bit."""
    cluster, exact = Cluster(KERNEL, 7, 0.0), Exact(KERNEL, 7)
    ours, theirs = cluster.empty(2, 2), exact.empty(2, 2)
    z, alpha = points(15, 2), points(15, 2, seed=1)
    z[4] = z[3]
    for i in range(0, 15, 3):
        ours = stepped(cluster, ours, z[i : i + 3], alpha[i : i + 3], decay=0.9)
        theirs = stepped(exact, theirs, z[i : i + 3], alpha[i : i + 3], decay=0.9)
        for left, right in zip(jax.tree.leaves(ours[0]), jax.tree.leaves(theirs[0]), strict=True):
            np.testing.assert_array_equal(left, right)
    np.testing.assert_array_equal(ours[1].velocity, theirs[1].velocity)
    assert float(cluster.age(ours[1], 3)) == pytest.approx(float(exact.age(theirs[1], 3)))


def test_near_transitions_join() -> None:
    """Radius 1: the second is 0.5 from the first, the third 2 away; the fourth joins the third."""
    cluster = Cluster(KERNEL, 4, 1.0)
    z = np.array([[0.0, 0.0], [0.5, 0.0], [2.0, 0.0], [2.0, 0.9]])
    alpha = np.array([[1.0], [2.0], [4.0], [8.0]])
    state = stepped(cluster, cluster.empty(2, 1), z, alpha)
    assert int(cluster.size(*state)) == 2
    np.testing.assert_array_equal(state[0].centres[:2], [[0.0, 0.0], [2.0, 0.0]])
    np.testing.assert_array_equal(state[0].weights[:, 0], [3.0, 12.0, 0.0, 0.0])
    # The next transition is 0.6 from the first centre and 1.4 from the second: v is now 5 at the first alone.
    state = stepped(cluster, state, np.array([[0.6, 0.0]]), np.array([[5.0]]))
    np.testing.assert_array_equal(state[0].weights[:, 0], [8.0, 12.0, 0.0, 0.0])
    assert int(cluster.size(*state)) == 2


def test_more_clusters_than_room() -> None:
    """Room for two: the first two lead, and the rest joins the nearest of them, so that no coefficient is lost."""
    cluster = Cluster(KERNEL, 2, 0.1)
    z = np.array([[0.0, 0.0], [4.0, 0.0], [1.0, 0.0], [3.0, 0.0]])
    state = stepped(cluster, cluster.empty(2, 1), z, np.array([[1.0], [2.0], [4.0], [8.0]]))
    np.testing.assert_array_equal(state[0].centres, [[0.0, 0.0], [4.0, 0.0]])
    np.testing.assert_array_equal(state[0].weights[:, 0], [5.0, 10.0])


def test_what_joined_a_centre_that_gives_way_goes_with_it() -> None:
    """A full expansion, one transition near its oldest centre and one far from all: the latter takes that row."""
    cluster = Cluster(KERNEL, 2, 0.5)
    state = stepped(cluster, cluster.empty(2, 1), np.array([[0.0, 0.0], [2.0, 0.0]]), np.ones((2, 1)))
    state = stepped(cluster, state, np.array([[0.1, 0.0], [9.0, 0.0]]), np.array([[3.0], [7.0]]))
    np.testing.assert_array_equal(state[0].centres, [[9.0, 0.0], [2.0, 0.0]])
    np.testing.assert_array_equal(state[0].weights[:, 0], [7.0, 1.0])


def filled(pursuit: KernelMatchingPursuit, centres: np.ndarray, weights: np.ndarray) -> tuple:
    """h with these centres and weights, v = 0, in float64."""
    function, momentum = as_dtype(pursuit.empty(centres.shape[1], weights.shape[1]), jnp.float64)
    used = np.arange(pursuit.capacity) < len(centres)
    full = np.zeros((pursuit.capacity, centres.shape[1]))
    full[: len(centres)] = centres
    w = np.zeros((pursuit.capacity, weights.shape[1]))
    w[: len(centres)] = weights
    return type(function)(jnp.asarray(full), jnp.asarray(w)), type(momentum)(
        momentum.velocity, momentum.added, momentum.born, momentum.updates, jnp.asarray(used), momentum.error
    )


def distance(left: tuple, right: tuple) -> float:
    """|f - g| in the RKHS for f, g given as (centres, weights)."""
    return rkhs_norm(np.concatenate([left[0], right[0]]), np.concatenate([left[1], -right[1]]), WIDTH)


def test_pursuit_takes_out_what_others_stand_in_for() -> None:
    """A centre that is there twice goes at no cost: the other takes its weight, and h is what it was."""
    with jax.enable_x64(True):
        centres = np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
        weights = np.array([[1.0], [2.0], [4.0]])
        pursuit = KernelMatchingPursuit(KERNEL, 3, 0.0)
        new = np.array([[5.0, 5.0]])
        function, momentum = stepped(pursuit, filled(pursuit, centres, weights), new, np.array([[3.0]]))
        expected = gaussian_sum(
            np.concatenate([centres, new]), np.array([[1.0], [2.0], [4.0], [3.0]]), ELSEWHERE, WIDTH
        )
        np.testing.assert_allclose(value(pursuit, function, ELSEWHERE), expected, atol=1e-6)
        assert float(momentum.error) < 1e-6
        assert int(pursuit.size(function, momentum)) == 3


def test_pursuit_costs_what_the_projection_loses() -> None:
    """Two centres at squared distance 1, k = exp(-1/2), weights 1 and 3: the first goes and costs sqrt(1 - k^2).

    K(c1, .) is k K(c2, .) plus a part of length sqrt(1 - k^2); so the other's weight becomes 3 + k.
    """
    with jax.enable_x64(True):
        centres, weights = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[1.0], [3.0]])
        pursuit = KernelMatchingPursuit(KERNEL, 2, 0.0)
        state = stepped(pursuit, filled(pursuit, centres, weights), np.array([[9.0, 9.0]]), np.array([[0.5]]))
        k = np.exp(-0.5)
        np.testing.assert_allclose(state[0].weights[:, 0], [0.5, 3 + k], rtol=1e-9)
        assert float(state[1].error) == pytest.approx(np.sqrt(1 - k**2), rel=1e-6)


@pytest.mark.parametrize("error", [0.3, 1.0])
def test_pruning_never_errs_more_than_it_may(error: float) -> None:
    """20 centres in room for 24: h stays within the error that was allowed and within the bound that is kept.

    True distances by NumPy from the whole Gram matrix. The step adds a centre of weight 0 coefficient.
    """
    with jax.enable_x64(True):
        centres, weights = points(20, 2, seed=3), 0.3 * points(20, 2, seed=4)
        pursuit = KernelMatchingPursuit(KERNEL, 24, error)
        state = stepped(pursuit, filled(pursuit, centres, weights), np.zeros((1, 2)), np.zeros((1, 2)))
        kept = np.asarray(state[0].centres), np.asarray(state[0].weights)
        moved, bound = distance((centres, weights), kept), float(state[1].error)
        assert 0 < moved <= bound * (1 + 1e-6)
        assert bound <= error
        assert int(pursuit.size(*state)) < 20
        assert float(pursuit.figures(state[1])["pruning_error"]) == bound


def test_without_allowance_centres_go_only_for_room_and_the_bound_holds() -> None:
    """Room for 8, six steps of two: never more than 8, all used once full, each step within its bound."""
    with jax.enable_x64(True):
        pursuit = KernelMatchingPursuit(KERNEL, 32, 0.0)
        state = filled(pursuit, points(31, 2, seed=5), points(31, 2, seed=6))
        before = np.asarray(state[0].centres), np.asarray(state[0].weights)
        state = stepped(pursuit, state, ELSEWHERE[:2], np.zeros((2, 2)))
        assert int(pursuit.size(*state)) == 32
        kept = np.asarray(state[0].centres), np.asarray(state[0].weights)
        assert 0 < distance(before, kept) <= float(state[1].error) * (1 + 1e-6)


def test_pursuit_projects_the_gradient_of_a_large_batch() -> None:
    """Of 40 transitions 32/16 = 2 become centres; h gets the projection, equal to the gradient at all centres."""
    with jax.enable_x64(True):
        pursuit = KernelMatchingPursuit(KERNEL, 32, 0.0)
        state = filled(pursuit, points(6, 2, seed=5), np.zeros((6, 2)))
        z, alpha = points(40, 2, seed=7), points(40, 2, seed=8)
        function, momentum = stepped(pursuit, state, z, alpha)
        assert int(pursuit.size(function, momentum)) == 8
        centres = np.asarray(function.centres)[:8]
        np.testing.assert_allclose(value(pursuit, function, centres), gaussian_sum(z, alpha, centres, WIDTH), atol=1e-8)
        # New centres are transitions of the batch.
        assert all(np.abs(z - centre).sum(axis=1).min() == 0 for centre in centres[6:])


def test_a_new_centre_is_judged_by_what_it_will_be() -> None:
    """With momentum 0.9 a centre starts with a tenth of its weight; the small old one goes, not the new one.

    Far apart, so that costs are weights: the old centre's is 0.5. The new one's is 0.1 now, and with v = 0.1 still to
    come nine times sqrt(0.1^2 + 0.9^2) = 0.906.
    """
    with jax.enable_x64(True):
        pursuit = KernelMatchingPursuit(KERNEL, 2, 0.0)
        state = filled(pursuit, np.array([[0.0, 0.0]]), np.array([[0.5]]))
        state = stepped(pursuit, state, np.array([[20.0, 0.0]]), np.array([[1.0]]), decay=0.9)
        state = stepped(pursuit, state, np.array([[0.0, 20.0]]), np.array([[0.0]]), decay=0.9)
        np.testing.assert_array_equal(state[0].centres, [[0.0, 20.0], [20.0, 0.0]])
        assert float(state[1].error) == pytest.approx(0.5, rel=1e-6)
