"""The census: what is remembered of actors and messages, by slot, by reason, and never more than that."""

from __future__ import annotations

import pytest
from samples import RUN, STATUS_NOW, heartbeat, settings

from common.wire.messages import ACCEPTED, PushReply
from common.wire.report import LONGEST, RunReport
from services.learner.endpoints.monitor import KEPT_VERSIONS, RunMonitor
from services.learner.scheduling.fleet import Fleet

KEY = "reskpn/v1/run-1/rollout/"


@pytest.fixture
def fleet() -> Fleet:
    return Fleet(RUN, 2)


@pytest.fixture
def census(fleet: Fleet) -> RunMonitor:
    """Begun at 100 s; "a" joined slot 0 at 101 s and was heard of at 102 s, with version 4."""
    census = RunMonitor(RUN, settings(), 100.0)
    fleet.join("a", "native", 101.0)
    census.joined(0, "a", "here", 101.0)
    fleet.record_heartbeat(heartbeat(0, "a", "collecting", version=4, state_s=0.5), 102.0)
    return census


def report(census: RunMonitor, fleet: Fleet, now_s: float = 103.0) -> RunReport:
    return census.report(fleet, "waits", now_s, 7)


def test_times_count_up_to_the_answer(census: RunMonitor, fleet: Fleet) -> None:
    """At 103 s: up for 3 s, heard of 1 s ago, in its state for 0.5 + 1 s, slot 1 empty since the start."""
    found = report(census, fleet)
    (actor,) = found.actors
    assert (found.up_s, found.t_ns, found.waiting_for) == (3.0, 7, "waits")
    assert (actor.heard_s, actor.state_s, actor.host) == (1.0, 1.5, "here")
    assert [(vacancy.slot, vacancy.lost, vacancy.for_s) for vacancy in found.vacancies] == [(1, False, 3.0)]


def test_the_age_of_a_snapshot(census: RunMonitor, fleet: Fleet) -> None:
    """Since its version was published; not known for one that is too old."""
    assert report(census, fleet).actors[0].snapshot_age_s is None
    census.published(4, 102.25)
    assert report(census, fleet).actors[0].snapshot_age_s == 0.75
    for version in range(5, 5 + KEPT_VERSIONS):
        census.published(version, 102.5)
    assert report(census, fleet).actors[0].snapshot_age_s is None


def test_rollouts_are_counted_by_slot_and_in_all(census: RunMonitor, fleet: Fleet) -> None:
    """Accepted, repeated, busy and refused; a key that names no slot of the run counts in all alone."""
    census.accepted(0)
    census.answered(f"{KEY}0", ACCEPTED, 102.0)
    census.answered(f"{KEY}0", PushReply.busy("queue_full", "the learner's queue is full"), 102.0)
    census.answered(f"{KEY}0", PushReply.refused("stale", "too old: by far"), 102.0)
    for stray in ("2", "*", "99999999999999", "x", "", "٣"):
        census.answered(f"{KEY}{stray}", PushReply.refused("bad_key", "no"), 102.5)
    found = report(census, fleet)
    actor = found.actors[0]
    assert (actor.accepted, actor.repeated, actor.busy, actor.refused) == (1, 1, 1, 1)
    totals = found.totals
    assert (totals.accepted, totals.repeated, totals.busy, totals.refused) == (1, 1, 1, 7)
    assert found.refusals == {"rollout": {"stale": 1, "bad_key": 6}}
    assert found.last_refusal is not None
    assert (found.last_refusal.reason, found.last_refusal.text, found.last_refusal.ago_s) == ("bad_key", "no", 0.5)


def test_a_new_incarnation_starts_at_zero(census: RunMonitor, fleet: Fleet) -> None:
    """A repeated question of the same one does not; the run's own counts go on."""
    census.accepted(0)
    census.joined(0, "a", "here", 102.0)
    assert report(census, fleet).actors[0].accepted == 1
    fleet.remove("a")
    census.left(0, 102.0)
    lost = report(census, fleet)
    assert [(vacancy.slot, vacancy.lost, vacancy.for_s) for vacancy in lost.vacancies] == [
        (0, True, 1.0),
        (1, False, 3.0),
    ]
    fleet.join("b", "native", 102.5)
    census.joined(0, "b", "there", 102.5)
    found = report(census, fleet)
    assert (found.actors[0].accepted, found.actors[0].generation, found.actors[0].host) == (0, 1, "there")
    assert (found.totals.accepted, found.totals.joined, found.totals.lost) == (1, 2, 1)


def test_what_the_loop_told_last(census: RunMonitor, fleet: Fleet) -> None:
    """With its age; nothing before it has told anything."""
    assert report(census, fleet).progress is None
    census.progressed(STATUS_NOW, 102.0)
    progress = report(census, fleet).progress
    assert progress is not None
    assert (progress.phase, progress.version, progress.age_s) == ("training", 5, 1.0)
    assert (progress.train_return, progress.step_reward) == (8.5, 0.25)


def test_refusals_by_kind_and_by_reason(census: RunMonitor, fleet: Fleet) -> None:
    """The same reason of two kinds is one in the sum."""
    census.refused("join", "schema", "old", 102.0)
    census.refused("heartbeat", "schema", "old", 102.0)
    census.join_refused("no_slot")
    assert census.refusals() == {"schema": 2}
    found = report(census, fleet)
    assert found.refusals == {"join": {"schema": 1}, "heartbeat": {"schema": 1}}
    assert found.refused_joins == {"no_slot": 1}


def test_texts_of_others_are_made_fit(census: RunMonitor, fleet: Fleet) -> None:
    """However long and whatever is in them: the report can always be made and read."""
    census.joined(1, "b", "\x1b[2J" + "h" * 1000, 102.0)
    census.refused("rollout", "bad_value", "\x07" + "t" * 10_000, 102.0)
    fleet.join("b" * 128, "native", 102.0)
    found = census.report(fleet, "w" * 10_000, 103.0, 7)
    assert RunReport.decode(found.encode()) == found
    assert len(found.waiting_for) == LONGEST
    assert found.actors[1].host.startswith("?[2Jhh")
    assert found.last_refusal is not None
    assert found.last_refusal.text.startswith("?tt")
