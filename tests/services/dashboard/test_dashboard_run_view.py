"""One run as pages get it: everything once, then what is new."""

from __future__ import annotations

from dashboard_runs import T0_NS, evaluation, update

from services.dashboard.run_view import KEPT_EVENTS, Cursor, RunView

HOUR_NS = 3600 * 10**9


def test_first_everything_and_then_what_is_new() -> None:
    """An update after the first look is one row; where nothing is new there is no message."""
    view = RunView("one")
    view.begin(T0_NS)
    view.add("/update", update(1), T0_NS + HOUR_NS)
    first, cursor = view.since(Cursor())
    assert first is not None
    assert first["fresh"] is True
    assert first["columns"]["run/return"] == [10.0]
    assert first["columns"]["hours"] == [1.0]
    nothing, cursor = view.since(cursor)
    assert nothing is None
    view.add("/update", update(2), T0_NS + 2 * HOUR_NS)
    view.add("/eval", evaluation(2), T0_NS + 2 * HOUR_NS)
    view.add("/event", {"level": "info", "text": "x"}, T0_NS)
    view.show({"phase": "training"})
    second, _ = view.since(cursor)
    assert second is not None
    assert (second["start"], second["columns"]["run/return"]) == (1, [20.0])
    assert [one["return_mean"] for one in second["evaluations"]] == [22.0]
    assert [one["text"] for one in second["events"]] == ["x"]
    assert second["state"] == {"phase": "training"}
    assert "fresh" not in second


def test_a_page_of_another_life_begins_anew() -> None:
    """As when a damaged log was repaired and read from its start."""
    before, after = RunView("one"), RunView("one")
    _, cursor = before.since(Cursor())
    found, _ = after.since(cursor)
    assert found is not None
    assert found["fresh"] is True


def test_old_logs_have_the_return_of_their_episodes() -> None:
    """They lack `progress`; the episodes of an update are logged before it."""
    view = RunView("one")
    record = update(1)
    del record["progress"]
    view.add("/episode", {"return_mean": 7.5}, T0_NS)
    view.add("/update", record, T0_NS)
    assert view.latest["run/return"] == 7.5


def test_an_evaluation_that_is_repeated_is_drawn_once() -> None:
    view = RunView("one")
    for _ in range(3):
        view.add("/eval", evaluation(2), T0_NS)
    view.add("/eval", evaluation(2, "run"), T0_NS)
    found, _ = view.since(Cursor())
    assert found is not None
    assert [one["source"] for one in found["evaluations"]] == ["evaluator-5f31aa00", "run"]


def test_events_are_bounded() -> None:
    """The newest are kept, and a page that looks late gets those."""
    view = RunView("one")
    for number in range(KEPT_EVENTS + 50):
        view.add("/event", {"level": "info", "text": str(number)}, T0_NS)
    found, _ = view.since(Cursor())
    assert found is not None
    assert [found["events"][0]["text"], found["events"][-1]["text"]] == ["50", str(KEPT_EVENTS + 49)]
    assert len(found["events"]) == KEPT_EVENTS


def test_a_record_without_version_is_passed_over() -> None:
    view = RunView("one")
    view.add("/update", {"version": "x", "env_steps": 1}, T0_NS)
    view.add("/update", {}, T0_NS)
    assert view.latest == {}
