"""Two commits are compared in turns, by ratios within a round."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from benchmarks.compare_commits import describe_ratio, in_turns, unpacked
from common.errors import ProcessError


def test_rounds_begin_with_each_commit_in_turn() -> None:
    """Old first, then new first; each pair is (old, new) all the same."""
    order: list[str] = []

    def measure(name: str, value: float) -> Callable[[], tuple[float, ...]]:
        def once() -> tuple[float, ...]:
            order.append(name)
            return (value,)

        return once

    assert in_turns(measure("old", 1.0), measure("new", 2.0), 2) == [((1.0,), (2.0,))] * 2
    assert order == ["old", "new", "new", "old"]


def test_the_ratio_is_taken_within_rounds() -> None:
    """Rounds of 1 -> 2, 10 -> 10 and 4 -> 2 have the ratios 2, 1 and 0.5: the median is 1, the range 0.5 to 2."""
    line = describe_ratio("x", "s", [(1.0, 2.0), (10.0, 10.0), (4.0, 2.0)])
    assert line.split() == ["x", "4.000", "2.000", "s", "1.00", "0.50-2.00"]


def test_an_unknown_commit_is_named() -> None:
    """The error repeats the commit that was given."""
    with pytest.raises(ProcessError, match="no-such-commit"), unpacked("no-such-commit"):
        pass
