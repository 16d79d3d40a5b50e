"""Names that are mistyped, and the nearest ones that are not."""

from __future__ import annotations

import pytest

from common.suggestions import nearest_path, unknown_name
from common.tasks import TASKS


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


SETTINGS = (
    "task",
    "num-envs",
    "total-steps",
    "algorithm.gamma",
    "algorithm.learning-rate",
    "algorithm.clip",
    "rkhs.clip",
)


@pytest.mark.parametrize(
    ("given", "near"),
    [
        ("taks", "task"),  # two letters in the wrong order
        ("num_envs", "num-envs"),  # as the file and the environment have it
        ("algorithm.lr", "algorithm.learning-rate"),  # its initials
        ("lr", "algorithm.learning-rate"),
        ("gamma", "algorithm.gamma"),  # without its section
        ("algorithm.gama", "algorithm.gamma"),
        ("rkhs.gamma", "algorithm.gamma"),  # in the wrong section
        ("rkhs.clipp", "rkhs.clip"),  # both sections have one: that of the same section
        ("gama", "algorithm.gamma"),
        ("zzz", None),
    ],
)
def test_the_nearest_setting(given: str, near: str | None) -> None:
    """By its whole name, or by its last part where the section is missing or wrong."""
    assert nearest_path(given, SETTINGS, ".") == near
