"""The tasks by name, and the sentence for a name that is none. (Their sizes are checked with the physics.)"""

from __future__ import annotations

import pytest

from common.tasks import EPISODE_LENGTH, TASKS, Task, unknown_name


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


@pytest.mark.parametrize(
    ("given", "near"),
    [("hoper", "hopper"), ("Hopper", "hopper"), ("half_cheetah", "halfcheetah"), ("walker", "walker2d")],
)
def test_a_misspelled_name_is_answered_with_the_nearest(given: str, near: str) -> None:
    """Whatever its case, together with all that are allowed."""
    assert unknown_name("task", given, TASKS) == (
        f"{given!r} is not a task; did you mean {near!r}? allowed: {', '.join(TASKS)}"
    )


def test_a_name_like_no_other_is_answered_with_all() -> None:
    """No guess where nothing is near."""
    assert unknown_name("colour", "qqq", iter(["red", "green"])) == "'qqq' is not a colour; allowed: red, green"


def test_the_nearest_name_keeps_its_case() -> None:
    """The answer can be typed as it stands."""
    assert "did you mean 'RESKPN_TASK'?" in unknown_name("setting", "reskpn_tusk", ["RESKPN_TASK"])
