"""What a run is judged by: episodes, returns, and where the time goes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from samples import rollout

from common.runs.tally import RECENT_EPISODES
from services.learner.reporting.statistics import Episodes, TrainingReturn, actor_seconds, step_reward


def ended(*episodes: tuple[float, int]) -> dict[str, Any]:
    """The fields of a rollout in which episodes of these returns and lengths ended."""
    return {
        "episode_return": np.array([value for value, _ in episodes], np.float32),
        "episode_length": np.array([length for _, length in episodes], np.int32),
    }


def episodes(*returns: float) -> Episodes:
    return Episodes(np.array(returns, np.float32), np.ones(len(returns), np.int32))


def test_the_record_of_a_batch() -> None:
    """Count, mean, least and greatest return and mean length over the episodes of all rollouts."""
    batch = [rollout(**ended((2.0, 10), (4.0, 20))), rollout(1, "b", **ended((9.0, 30)))]
    # mean return (2 + 4 + 9) / 3 = 5, mean length (10 + 20 + 30) / 3 = 20
    assert Episodes.of(batch).record(12) == {
        "version": 12,
        "count": 3,
        "return_mean": 5.0,
        "return_min": 2.0,
        "return_max": 9.0,
        "length_mean": 20.0,
    }


def test_without_an_episode_there_is_no_record() -> None:
    """No mean of nothing."""
    assert Episodes.of([rollout(), rollout(1, "b")]).record(1) is None


def test_the_newest_return_is_a_mean_over_200_episodes() -> None:
    """None before the first episode has ended; older ones drop out once newer updates have 200."""
    result = TrainingReturn(updates=10)
    assert result.newest is None
    result.add(1, episodes(1.0, 3.0))
    assert result.newest == 2.0
    result.add(2, episodes(*[7.0] * RECENT_EPISODES))
    assert result.newest == 7.0
    assert result.episodes == 202


def test_the_newest_return_is_of_all_episodes_of_an_update() -> None:
    """Where more than 200 ended in one update, all of them count, so that the order of slots and steps does not.

    1,600 episodes of return 10 from the first slot, then 400 of return 63 from the second:
    (1,600 * 10 + 400 * 63) / 2,000 = 20.6; the last 200 alone would show 63. The next update's 100 episodes are fewer
    than 200, so the 2,000 before them still count: (2,000 * 20.6 + 100 * 41.6) / 2,100 = 21.6.
    """
    result = TrainingReturn(updates=10)
    result.add(1, episodes(*[10.0] * 1600, *[63.0] * 400))
    assert result.newest == pytest.approx(20.6)
    result.add(2, episodes(*[41.6] * 100))
    assert result.newest == pytest.approx(21.6)


def test_a_resumed_run_shows_the_return_of_the_run_that_went_on() -> None:
    """Live from the episodes, resumed from the log's records of them: the same figures, to the bit."""
    live, resumed = TrainingReturn(updates=10), TrainingReturn(updates=10)
    draw = np.random.default_rng(0)
    for version, count in enumerate((7, 0, 450, 30, 120, 90), start=5):
        ended = Episodes(draw.normal(50.0, 30.0, count).astype(np.float32), np.ones(count, np.int32))
        live.add(version, ended)
        if (record := ended.record(version)) is not None:
            resumed.recall(record)
        assert (resumed.newest, resumed.late, resumed.episodes) == (live.newest, live.late, live.episodes)


@pytest.mark.parametrize(
    ("updates", "late"),
    # The last tenth: of 30 updates the last 3 (28, 29, 30); of fewer than 20, the last alone.
    [(30, (28 + 29 + 30) / 3), (19, 19.0), (1, 1.0)],
)
def test_the_late_return_is_that_of_the_last_tenth(updates: int, late: float) -> None:
    """Every update ends one episode, whose return is the update's number."""
    result = TrainingReturn(updates)
    for version in range(1, updates + 1):
        result.add(version, episodes(float(version)))
    assert result.late == late


def test_the_late_return_weighs_every_episode_alike() -> None:
    """(1 + 1 + 1 + 9) / 4 = 3, whichever updates the episodes ended in."""
    result = TrainingReturn(updates=20)
    result.add(19, episodes(1.0, 1.0, 1.0))
    result.add(20, episodes(9.0))
    assert result.late == 3.0


def test_the_slowest_actor_counts() -> None:
    """By phase, over all rollouts; an actor that does not tell a phase spent no time on it."""
    batch = [
        rollout(timing={"collect": 1.0, "physics": 2.0}),
        rollout(1, "b", timing={"collect": 1.5, "push": 0.25}),
    ]
    assert actor_seconds(batch) == {"collect": 1.5, "physics": 2.0, "push": 0.25}


def test_the_reward_of_a_step() -> None:
    """The mean over the steps and environments of all rollouts, whether or not an episode ended."""
    three_steps_of_two = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], np.float32)
    batch = [rollout(reward=three_steps_of_two), rollout(1, "b", reward=three_steps_of_two + 2.0)]
    # (1 + 2 + 3 + 4 + 5 + 6) / 6 = 3.5 and 5.5
    assert step_reward(batch) == 4.5
