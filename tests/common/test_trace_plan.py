"""`--trace` as it is written, and the first update that it means."""

from __future__ import annotations

import pytest

from common.errors import SettingsError
from common.trace_plan import TracePlan


@pytest.mark.parametrize("text", ["5", "5@100", "1000@1"])
def test_a_plan_is_written_as_it_is_read(text: str) -> None:
    """So `reskpn train` can hand it to its learner."""
    assert TracePlan.parse(text).written() == text


@pytest.mark.parametrize("text", ["", "0", "1001", "five", "-1", "5@", "5@0", "@5", "5@1@2", "1e3", "\u0665"])
def test_anything_else_is_refused_with_what_is_allowed(text: str) -> None:
    """The sentence shows both ways to write it."""
    with pytest.raises(SettingsError, match=r"--trace .*1 to 1000.*--trace 5 or --trace 5@100"):
        TracePlan.parse(text)


def test_the_first_updates_of_a_process_are_not_traced_unless_named() -> None:
    """A resumed run may begin at version 70: its third update then leads to 73. A named version may have passed."""
    assert [TracePlan(5).is_due(version, made) for made, version in enumerate((71, 72, 73, 74))] == [
        *(False, False, True, True)
    ]
    assert TracePlan(5, 1).is_due(1, 0)
    assert [TracePlan(5, 72).is_due(version, 0) for version in (71, 72, 73)] == [False, True, True]
