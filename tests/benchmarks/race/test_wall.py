"""Curves over wall time: what is reported is kept, and what is read off is what the note under the table says."""

from __future__ import annotations

import json

import pytest

from benchmarks.race.reporting import Reporter
from benchmarks.race.wall import Report, WallCurve, curve_of, parse_reports
from common.errors import LogReadError

ABOUT = json.dumps({"about": {"versions": {"lib": "1.0"}, "settings": {"gamma": 0.9}}})


def report(at_s: float, env_steps: int = 0, episodes: int = 1, return_sum: float = 0.0) -> Report:
    return Report(at_s, env_steps, episodes, return_sum)


def test_reports_fall_into_rows_of_two_seconds() -> None:
    """Rows end at 2, 4 and 6 s: 0.5 and 2.0 are in the first, 2.1 in the second, none in the third, 6.1 is too late."""
    reports = [report(0.5, 100, 1, 10.0), report(2.0, 200, 2, 50.0), report(2.1, 300, 1, 7.0), report(6.1, 900, 5, 1e6)]
    curve = curve_of(reports, 6.0)
    assert curve.time_s == [2.0, 4.0, 6.0]
    assert curve.env_steps == [200, 300, 300]
    assert curve.episodes == [3, 1, 0]
    assert curve.mean_return == [20.0, 7.0, None]  # (10 + 50) / 3


def curve(*means: float | None, episodes: int = 1) -> WallCurve:
    """Rows of two seconds with these means."""
    return WallCurve(
        time_s=[2.0 * (row + 1) for row in range(len(means))],
        env_steps=[100 * (row + 1) for row in range(len(means))],
        episodes=[0 if mean is None else episodes for mean in means],
        mean_return=list(means),
    )


def test_the_return_at_a_time_is_of_the_last_tenth_until_then() -> None:
    """At 40 s: the episodes of rows that end after 36 s, which are 38 and 40."""
    found = curve(*[0.0] * 17, 5.0, 10.0, 30.0, 999.0)
    assert found.return_at(40.0) == 20.0
    assert found.return_at(36.0) == pytest.approx(2.5)  # rows 34 and 36: 0 and 5


def test_episodes_count_by_their_number() -> None:
    """Three episodes of 10 and one of 50 in the window: 80 / 4."""
    found = WallCurve(time_s=[38.0, 40.0], env_steps=[1, 2], episodes=[3, 1], mean_return=[10.0, 50.0])
    assert found.return_at(40.0) == 20.0


def test_without_episodes_in_the_window_the_newest_before_count() -> None:
    """Long episodes that end all at once, as those of 2,048 environments that began together."""
    found = curve(None, 3.0, 4.0, *[None] * 17)
    assert found.return_at(40.0) == 4.0
    assert found.return_at(2.0) is None


def test_the_time_to_a_return_is_the_first_at_which_it_is_reached() -> None:
    found = curve(10.0, 20.0, None, 40.0, 10.0)
    assert found.time_to(20.0) == 4.0
    assert found.time_to(40.0) == 8.0
    assert found.time_to(41.0) is None


def test_steps_at_a_time_are_those_made_until_then() -> None:
    found = curve(1.0, 1.0, 1.0)
    assert (found.steps_at(1.0), found.steps_at(4.5), found.steps_at(60.0)) == (0, 200, 300)


def test_what_an_entrant_prints_is_read_beside_other_output() -> None:
    """Times count from the launch; a line that is no JSON, an array and a line that was cut off are left out."""
    lines = ["Using cpu device", ABOUT, '{"at": 105.5, "env_steps": 512, "episodes": 2, "return_sum": 30.5}']
    about, reports = parse_reports([*lines, "[1, 2]", '{"at": 107.1, "env_st'], 100.0)
    assert about["settings"] == {"gamma": 0.9}
    assert reports == [Report(5.5, 512, 2, 30.5)]


def test_an_entrant_that_never_introduced_itself_is_refused() -> None:
    with pytest.raises(LogReadError, match="did not get as far"):
        parse_reports(["Traceback"], 0.0)


def test_a_report_without_its_numbers_is_refused_with_the_line() -> None:
    with pytest.raises(LogReadError, match="env_steps"):
        parse_reports([ABOUT, '{"at": 1.0, "episodes": 2}'], 0.0)


def test_the_reporter_prints_what_the_race_reads(capsys: pytest.CaptureFixture[str]) -> None:
    """Episodes that end within half a second are added up; the last ones wait for the next report."""
    reporter = Reporter(("numpy",), {"gamma": 0.9})
    reporter.add(10, 1, 5.0)
    reporter.add(20, 1, 7.0)  # at once after the first: not printed yet
    about, reports = parse_reports(capsys.readouterr().out.splitlines(), 0.0)
    assert about["settings"] == {"gamma": 0.9}
    assert set(about["versions"]) == {"numpy"}
    assert [(each.env_steps, each.episodes, each.return_sum) for each in reports] == [(10, 1, 5.0)]
    reporter._printed_s = 0.0
    reporter.add(30, 1, 9.0)
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["return_sum"] == 16.0  # 7 + 9
