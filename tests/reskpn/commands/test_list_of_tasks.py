"""`reskpn tasks`: every task there is in one table, and one of a user's own that need not be right."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from reskpn.cli import main

Captured = pytest.CaptureFixture[str]


def listed(capsys: Captured, *own: str) -> dict[str, dict[str, object]]:
    """The rows of `reskpn tasks --json` by name."""
    assert main(["tasks", "--json", *own]) == 0
    return {row["name"]: row for row in json.loads(capsys.readouterr().out)}


def test_tasks_of_the_paper_and_gymnasiums(capsys: Captured) -> None:
    """Eight and eleven; sizes as Brax and Gymnasium publish them."""
    rows = listed(capsys)
    families = [row["family"] for row in rows.values()]
    assert (families.count("paper"), families.count("gymnasium")) == (8, 11)
    assert [rows["hopper"][name] for name in ("observation", "action", "step_s", "episode")] == [11, 3, 0.008, 1000]
    assert [rows["hopper-v5"][name] for name in ("observation", "action", "step_s", "episode")] == [11, 3, 0.008, 1000]
    assert [rows["ant-v5"][name] for name in ("observation", "action")] == [105, 8]


def test_a_task_of_ones_own_is_listed(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example: sine and cosine of two angles and two velocities, two motors."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "examples"))
    row = listed(capsys, "double_pendulum:DoublePendulum")["double_pendulum:DoublePendulum"]
    assert [row[name] for name in ("family", "observation", "action", "episode", "fault")] == ["own", 6, 2, 500, ""]


def test_a_task_that_cannot_be_loaded_is_a_row_with_the_reason(capsys: Captured) -> None:
    """And the others are listed all the same."""
    rows = listed(capsys, "no_such_module_here:Robot")
    assert len(rows) == 20
    assert "no_such_module_here" in str(rows["no_such_module_here:Robot"]["fault"])
    assert rows["no_such_module_here:Robot"]["observation"] is None


def test_the_table_names_units(capsys: Captured) -> None:
    """A heading over each column."""
    assert main(["tasks"]) == 0
    heading, *rows = capsys.readouterr().out.splitlines()
    assert heading.split("  ")[0] == "task"
    assert "step (s)" in heading
    assert len(rows) == 19
