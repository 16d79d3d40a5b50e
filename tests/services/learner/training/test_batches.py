"""Rollouts side by side: the batch of one update."""

from __future__ import annotations

import numpy as np
from samples import rollout

from services.learner.training.batches import assemble


def test_environments_lie_side_by_side_in_the_order_given() -> None:
    """Two rollouts of T = 3, N = 2 make a batch of T = 3, E = 4, whose first two columns are the first rollout's."""
    first, second = rollout(1, "b", seq=4), rollout(0, "a", seq=2)
    batch = assemble([first, second])
    pairs = {
        "obs": "obs",
        "action": "action",
        "log_prob": "log_prob",
        "reward": "reward",
        "terminated": "terminated",
        "truncated": "truncated",
    }
    for name, field in pairs.items():
        made = np.asarray(getattr(batch, name))
        assert made.shape[:2] == (3, 4), name
        np.testing.assert_array_equal(made[:, :2], getattr(first, field), err_msg=name)
        np.testing.assert_array_equal(made[:, 2:], getattr(second, field), err_msg=name)
    np.testing.assert_array_equal(batch.last_obs[:2], first.last_obs)
    np.testing.assert_array_equal(batch.last_obs[2:], second.last_obs)
    assert np.asarray(batch.slot).tolist() == [1, 0]


def test_one_rollout_is_a_batch() -> None:
    """With one actor the batch is the rollout."""
    made = rollout(0, "a", seq=3)
    batch = assemble([made])
    np.testing.assert_array_equal(batch.obs, made.obs)
    np.testing.assert_array_equal(batch.reward, made.reward)
    np.testing.assert_array_equal(batch.last_obs, made.last_obs)
    assert np.asarray(batch.slot).tolist() == [0]


def test_dtypes() -> None:
    """Numbers are float32, flags bool and slots int32, as the update was compiled for."""
    batch = assemble([rollout(0, "a"), rollout(1, "b")])
    for name in ("obs", "action", "log_prob", "reward", "last_obs", "truncated_obs"):
        assert getattr(batch, name).dtype == np.float32, name
    for name in ("terminated", "truncated", "fresh"):
        assert getattr(batch, name).dtype == np.bool_, name
    assert batch.slot.dtype == np.int32


def test_a_cut_observation_goes_to_its_environment() -> None:
    """`truncated_obs` is in the order of time, then environment; the batch has a row for each environment."""
    truncated = np.zeros((3, 2), bool)
    truncated[0, 1] = truncated[2, 0] = True
    # First in time is environment 1, then environment 0.
    cut = np.array([[1, 1, 1, 1], [2, 2, 2, 2]], np.float32)
    batch = assemble([rollout(0, "a"), rollout(1, "b", truncated=truncated, truncated_obs=cut)])
    expected = [[0, 0, 0, 0], [0, 0, 0, 0], [2, 2, 2, 2], [1, 1, 1, 1]]
    assert np.asarray(batch.truncated_obs).tolist() == expected


def test_fresh_marks_the_first_rollout_of_a_life() -> None:
    """Only seq 0 comes from new environments."""
    batch = assemble([rollout(0, "a", seq=0), rollout(0, "a", seq=1), rollout(1, "b", seq=7)])
    assert np.asarray(batch.fresh).tolist() == [True, False, False]
