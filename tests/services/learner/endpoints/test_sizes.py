"""Messages that would never arrive are refused before a run begins."""

from __future__ import annotations

import numpy as np
import pytest
from samples import rollout, settings

from common.errors import SettingsError
from common.runs.rollout_shape import rollout_shape
from services.learner.endpoints.sizes import check_rollout_size, check_snapshot_size


def test_the_largest_rollout_fits_its_bound() -> None:
    """Every environment is cut at the last of T = 3 steps, of which each may end an episode: no message is larger."""
    given = settings(episode_length=3)
    truncated = np.zeros((3, 2), bool)
    truncated[2] = True
    largest = rollout(
        truncated=truncated,
        truncated_obs=np.zeros((2, 4), np.float32),
        episode_return=np.zeros(6, np.float32),
        episode_length=np.ones(6, np.int32),
        incarnation="i" * 128,
    )
    assert len(largest.encode()) <= rollout_shape(given).max_bytes < len(largest.encode()) + (1 << 17)


def test_rollouts_larger_than_a_message_are_refused_at_start() -> None:
    """16,384 humanoids (O = 244, A = 17) by one actor, 64 steps: 1,048,576 steps of 1,054 bytes and more."""
    humanoids = settings(task="humanoid", num_envs=16384, num_steps=64, actors=1, total_steps=1 << 22)
    with pytest.raises(SettingsError, match=r"up to 1,\d{3},\d{3},\d{3} bytes .*max_message_bytes allows 268,435,456"):
        check_rollout_size(humanoids)


def test_a_queue_without_room_for_a_rollout_is_refused_at_start() -> None:
    """Every push would be answered `busy` for ever."""
    with pytest.raises(SettingsError, match="queue_bytes"):
        check_rollout_size(settings(transport={"queue_bytes": 1 << 16}))


def test_usual_sizes_pass() -> None:
    """The defaults of every setting but the task."""
    check_rollout_size(settings())


def test_a_policy_larger_than_a_message_is_refused() -> None:
    """One byte more than allowed."""
    given = settings(transport={"max_message_bytes": 1000})
    check_snapshot_size(1000, given)
    with pytest.raises(SettingsError, match=r"the policy takes 1,001 bytes"):
        check_snapshot_size(1001, given)
