"""Records as points: known names, finite numbers, printable text, no secrets."""

from __future__ import annotations

import pytest
from dashboard_runs import SECRET, evaluation, update

from services.dashboard.points import evaluation_point, event_line, number, update_points, used_rollouts


def test_the_points_of_an_update() -> None:
    """By the names that TensorBoard has; a name that the page does not draw is left out."""
    points = update_points(update(4))
    assert points["run/return"] == 40.0
    assert points["train/kl"] == 0.04
    assert points["seconds/actor/physics"] == 0.3
    assert points["staleness/max"] == 0.0
    assert "unknown/name" not in points


@pytest.mark.parametrize("value", [None, "1", True, float("nan"), float("inf"), [1.0]])
def test_what_is_no_number_is_no_point(value: object) -> None:
    """It is left out, and the others are kept."""
    points = update_points(update(1, metrics={"train/kl": value, "policy/std": 0.5}))
    assert "train/kl" not in points
    assert points["policy/std"] == 0.5
    assert number(value) is None


@pytest.mark.parametrize("part", ["metrics", "seconds", "staleness", "progress", "rollouts"])
def test_a_part_of_another_type(part: str) -> None:
    """Is as if it were not there."""
    record = update(1, **{part: "text"})
    assert update_points(record)
    assert part != "rollouts" or used_rollouts(record, 0) == {}


def test_numbers_are_sent_with_six_digits() -> None:
    assert number(1 / 3) == 0.333333
    assert number(1234567.0) == 1234570.0


def test_incarnations_are_shortened() -> None:
    """Whoever knows the whole could act for the slot: neither the text of an event nor the fleet has it."""
    line = event_line({"level": "info", "text": f"slot 0, incarnation {SECRET}"}, 5 * 10**9)
    assert line == {"t_s": 5.0, "level": "info", "text": "slot 0, incarnation 01234567..."}
    assert used_rollouts(update(2), 7 * 10**9)[1] == {"incarnation": "01234567", "version": 1, "t_s": 7.0}


def test_control_characters_are_shown_as_question_marks() -> None:
    assert event_line({"level": "error", "text": "a\x1b[31m\nb"}, 0)["text"] == "a?[31m?b"


def test_an_evaluation_that_lacks_a_number_is_none() -> None:
    assert evaluation_point(evaluation(2)) == {
        "return_mean": 22.0, "return_std": 2.0, "version": 2, "env_steps": 24, "episodes": 16,
        "source": "evaluator-5f31aa00",
    }  # fmt: skip
    assert evaluation_point({**evaluation(2), "return_mean": None}) is None
