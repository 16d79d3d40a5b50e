"""The tasks by name. (Their sizes are checked with the physics.)"""

from __future__ import annotations

import pytest

from common.tasks import EPISODE_LENGTH, TASKS, Task


def test_the_eight_tasks_of_the_paper() -> None:
    """By brax's names; each is its own key."""
    assert list(TASKS) == [
        "inverted_pendulum",
        "hopper",
        "halfcheetah",
        "walker2d",
        "humanoid",
        "humanoidstandup",
        "pusher",
        "reacher",
    ]
    assert all(task.name == name for name, task in TASKS.items())
    assert EPISODE_LENGTH == 1000


@pytest.mark.parametrize(
    ("name", "observation_size", "action_size"),
    # The sizes of Gymnasium's classic tasks in brax's version: humanoids without external contact forces (376 - 132).
    [("inverted_pendulum", 4, 1), ("hopper", 11, 3), ("halfcheetah", 17, 6), ("humanoid", 244, 17), ("reacher", 11, 2)],
)
def test_sizes(name: str, observation_size: int, action_size: int) -> None:
    """O and A, which networks and messages are made by."""
    assert TASKS[name] == Task(name, observation_size, action_size)
