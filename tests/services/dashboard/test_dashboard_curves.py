"""Curves of bounded length."""

from __future__ import annotations

from services.dashboard.curves import Curves


def filled(updates: int, limit: int) -> Curves:
    curves = Curves(limit)
    for version in range(1, updates + 1):
        curves.add(version, {"env_steps": 10.0 * version, "hours": 0.5 * version, "a": float(version)})
    return curves


def test_rows_are_given_once() -> None:
    """From a number on, so that a page gets only what is new."""
    curves = filled(3, 100)
    assert curves.since(2) == {"env_steps": [30.0], "version": [3], "hours": [1.5], "a": [3.0]}
    assert curves.since(3)["a"] == []


def test_a_curve_never_goes_back() -> None:
    """A resumed run passes versions a second time: they are left out."""
    curves = filled(3, 100)
    curves.add(2, {"a": 99.0})
    assert curves.since(0)["a"] == [1.0, 2.0, 3.0]


def test_past_the_limit_neighbours_are_put_together() -> None:
    """With limit 4: rows 1, 2, 3, 4 become means of two at the places of the second; from then on two make one row."""
    curves = filled(4, 4)
    assert curves.since(0) == {"env_steps": [20.0, 40.0], "version": [2, 4], "hours": [1.0, 2.0], "a": [1.5, 3.5]}
    assert curves.width == 2
    before = curves.epoch
    curves.add(5, {"a": 5.0})
    assert len(curves) == 2
    curves.add(6, {"a": 7.0, "version": 6})
    assert curves.since(2)["a"] == [6.0]
    assert curves.epoch == before


def test_a_long_run_stays_within_the_limit() -> None:
    curves = filled(1000, 16)
    assert len(curves) < 16
    assert curves.since(0)["version"][-1] >= 1000 - curves.width


def test_a_curve_that_begins_later() -> None:
    """Has nothing before, and pages are told to begin anew."""
    curves = filled(2, 100)
    before = curves.epoch
    curves.add(3, {"a": 3.0, "late": 1.0})
    assert curves.since(0)["late"] == [None, None, 1.0]
    assert curves.epoch > before


def test_the_mean_of_what_is_known() -> None:
    """Of measured and not measured updates it is that of the measured."""
    curves = Curves(4)
    for version, value in enumerate([4.0, None, None, None], start=1):
        curves.add(version, {"a": value})
    assert curves.since(0)["a"] == [4.0, None]
