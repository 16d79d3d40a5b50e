"""The table and the picture of the race, from results that are made up."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.race import draw as draw_command
from benchmarks.race.entrants import entrant
from benchmarks.race.records import path_of
from benchmarks.race.standings import current, draw, standings
from common.errors import LogReadError
from reskpn.study.writing import write_result
from tests.benchmarks.race.results import result

THREE = [100.0, 500.0, 900.0]


def test_the_table_has_the_median_and_range_over_seeds() -> None:
    """Three runs of three minutes that end at 900, 1,200 and 2,400; one run of ten minutes."""
    runs = [result("reference", seed, [100.0, 500.0, end]) for seed, end in enumerate((2400.0, 900.0, 1200.0))]
    table = standings([*runs, result("default", 0, [1000.0 + 100 * minute for minute in range(10)])])
    assert table.header == [
        "task",
        "entrant",
        "return after 3 min",
        "return after 10 min",
        "steps/s",
        "minutes to 1,000",
    ]
    ours, theirs = table.rows
    # default's third minute is at 1,200, its tenth at 1,900; its first report, at 10 s, is at 1,000 already
    assert ours == ["hopper", "default", "1,200, 1", "1,900, 1", "1,000, 1", "0.2, 1"]
    # the last tenth of three minutes are 18 s, all at the end's return; none of them lasted ten minutes
    assert theirs[:5] == ["hopper", "reference", "1,200 (900 to 2,400), 3", "-", "1,000 (1,000 to 1,000), 3"]
    assert theirs[5].endswith("to never), 3")


def test_a_return_that_nobody_reached_is_said_with_the_time_they_had() -> None:
    table = standings([result("reference", 0, THREE), result("reference", 1, THREE)])
    assert table.rows[0][5] == "not in 3"


def test_our_own_come_first_and_tasks_in_their_order() -> None:
    runs = [result(name, 0, THREE, task=task) for name in ("reference", "default") for task in ("walker2d", "hopper")]
    assert [row[:2] for row in standings(runs).rows] == [
        ["hopper", "default"], ["hopper", "reference"], ["walker2d", "default"], ["walker2d", "reference"],
    ]  # fmt: skip


def test_the_note_says_what_counts_and_where_it_was_measured() -> None:
    note = standings([result("default", 0, THREE)], left_out=2).note
    for words in (
        "imports and compiling included",
        "2 cores of a processor",
        "2026-11-28",
        "2 results of other settings",
    ):
        assert words in note


def test_results_of_former_settings_are_left_out() -> None:
    now, before = result("default", 0, THREE), result("default", 1, THREE, identity="0123456789")
    assert current([now, before]) == ([now], 1)


def test_table_and_picture_go_between_the_marks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the files alone, and the same bytes each time."""
    for seed in (0, 1):
        for name in ("default", "reference"):
            write_result(result(name, seed, THREE), path_of(tmp_path / "race", entrant(name), "hopper", seed))
    document = tmp_path / "study.md"
    document.write_text("# Race\n\n<!-- drawn: race -->\n\nold\n\n<!-- end -->\n\nafter\n")
    words = ["--results", str(tmp_path / "race"), "--out", str(tmp_path / "study"), "--into", str(document)]
    assert draw_command.main(words) == 0
    text = document.read_text()
    assert "old" not in text
    assert text.endswith("<!-- end -->\n\nafter\n")
    assert "4 runs; tasks: hopper." in text
    assert "![race](study/race.svg)" in text
    assert "| hopper | default | 900 (900 to 900), 2 |" in text
    assert "| hopper | default |" in capsys.readouterr().out
    picture = (tmp_path / "study" / "race.svg").read_bytes()
    assert draw_command.main(words) == 0
    assert (tmp_path / "study" / "race.svg").read_bytes() == picture
    assert document.read_text() == text


def test_nothing_to_draw_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert draw([], 0, tmp_path) is None
    assert draw_command.main(["--results", str(tmp_path), "--out", str(tmp_path)]) == LogReadError.exit_code
    assert "has no results of the present settings" in capsys.readouterr().err
