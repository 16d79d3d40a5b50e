"""Async mode: what actors may make, which of it counts, and how old it is when it is used."""

from __future__ import annotations

from functools import partial

from samples import RUN, heartbeat, rollout

from common.wire.messages import PushReply
from common.wire.rollout import Rollout
from services.learner.scheduling.async_queue import AsyncQueue
from services.learner.scheduling.fleet import Fleet

UPDATES = 100


def make_fleet(slots: int, *incarnations: str, max_staleness: int = 1, updates: int = UPDATES) -> Fleet:
    """A fleet at version 0 whose actors, one a slot in the order given, are ready."""
    fleet = Fleet(RUN, slots, make_buffer=partial(AsyncQueue, max_staleness=max_staleness, updates=updates))
    fleet.begin(0)
    for number, incarnation in enumerate(incarnations):
        fleet.join(incarnation, "native", 0.0)
        fleet.record_heartbeat(heartbeat(number, incarnation), 0.0)
    return fleet


def push(fleet: Fleet, made: Rollout) -> None:
    """Bring in a rollout that must be admitted."""
    assert fleet.admit(made) is None
    fleet.accept(made)


def refusal(answer: PushReply | None) -> str:
    assert answer is not None
    assert answer.status == "refused"
    return answer.slug


def wanted(fleet: Fleet) -> dict[int, int]:
    return fleet.orders(digest="d", size=7, t_ns=3).collect


def used(fleet: Fleet) -> list[tuple[str, int]]:
    taken = fleet.take()
    assert taken is not None
    return [(made.incarnation, made.seq) for made in taken]


def test_actors_are_asked_for_more_than_one_update_needs() -> None:
    """With a bound of 1 there is work for two updates: one that is made while the other is learned from."""
    assert wanted(make_fleet(2, "a", "b")) == {0: 2, 1: 2}
    assert wanted(make_fleet(2, "a", "b", max_staleness=0)) == {0: 1, 1: 1}
    assert wanted(make_fleet(2, "a", "b", max_staleness=3)) == {0: 4, 1: 4}


def test_the_oldest_are_used_whoever_made_them() -> None:
    """An update waits for no slot: K rollouts in the order of the log, sorted by place."""
    fleet = make_fleet(2, "a", "b")
    assert fleet.take() is None
    for made in (rollout(1, "b", 0), rollout(1, "b", 1), rollout(0, "a", 0)):
        push(fleet, made)
    assert used(fleet) == [("b", 0), ("b", 1)]
    assert used(fleet) == [("b", 0), ("b", 1)]
    fleet.begin(1)
    assert fleet.take() is None
    push(fleet, rollout(0, "a", 1, policy_version=1))
    assert used(fleet) == [("a", 0), ("a", 1)]


def test_what_is_in_an_update_still_counts_while_it_is_made() -> None:
    """K in the update and K more of the same policy, then the next version is waited for: the bound is 1."""
    fleet = make_fleet(1, "a")
    push(fleet, rollout(0, "a", 0))
    assert used(fleet) == [("a", 0)]
    push(fleet, rollout(0, "a", 1))
    assert wanted(fleet) == {0: 2}
    assert refusal(fleet.admit(rollout(0, "a", 2))) == "surplus"
    fleet.begin(1)
    assert used(fleet) == [("a", 1)]
    # One of two is there; the count begins anew with every version.
    assert wanted(fleet) == {0: 1}


def test_one_that_was_begun_before_the_new_version_counts_against_it() -> None:
    """A rollout of version 0 that comes after version 1 was published takes the place of one of version 1."""
    fleet = make_fleet(1, "a")
    push(fleet, rollout(0, "a", 0))
    assert used(fleet) == [("a", 0)]
    fleet.begin(1)
    assert wanted(fleet) == {0: 2}
    push(fleet, rollout(0, "a", 1))
    assert wanted(fleet) == {0: 1}
    push(fleet, rollout(0, "a", 2, policy_version=1))
    assert wanted(fleet) == {0: 1}


def test_a_rollout_that_would_be_too_old_when_its_turn_comes_is_refused() -> None:
    """A slow actor is overtaken: its rollout is not logged, and the answer says what would be taken."""
    fleet = make_fleet(2, "fast", "slow")
    for version in (0, 1):
        fleet.begin(version)
        push(fleet, rollout(0, "fast", 2 * version, policy_version=version))
        push(fleet, rollout(0, "fast", 2 * version + 1, policy_version=version))
        assert fleet.take()
    # The next update, of policy 1, is full; the one after it takes policy 1 at the oldest.
    late = fleet.admit(rollout(1, "slow", 0, policy_version=0))
    assert refusal(late) == "stale"
    assert late is not None
    assert late.text.endswith("the update of policy 2 that would use it takes none older than 1")
    fleet.begin(2)
    assert refusal(fleet.admit(rollout(1, "slow", 0, policy_version=0))) == "stale"
    push(fleet, rollout(1, "slow", 0, policy_version=1))
    assert fleet.counts.refused == {"stale": 2}


def test_a_policy_that_is_not_published_yet_is_refused() -> None:
    fleet = make_fleet(1, "a")
    assert refusal(fleet.admit(rollout(0, "a", 0, policy_version=1))) == "stale"


def test_too_old_at_its_use_is_left_out() -> None:
    """One that was admitted in time and overtaken on its way to the log is given back, not used."""
    fleet = make_fleet(1, "a", max_staleness=0)
    late = rollout(0, "a", 0)
    assert fleet.admit(late) is None
    fleet.accept(late)
    assert fleet.begin(1) == [late]
    assert fleet.take() is None
    assert wanted(fleet) == {0: 1}


def test_nothing_is_asked_for_that_the_run_does_not_need() -> None:
    """Before the last update there is work for one only, at the end for none."""
    fleet = make_fleet(2, "a", "b", updates=2)
    assert wanted(fleet) == {0: 2, 1: 2}
    fleet.begin(1)
    assert wanted(fleet) == {0: 1, 1: 1}
    fleet.begin(2, collect=False)
    assert wanted(fleet) == {0: 0, 1: 0}
    assert refusal(fleet.admit(rollout(0, "a", 0, policy_version=2))) == "surplus"


def test_who_is_not_ready_is_not_waited_for() -> None:
    """The work is shared among those who are ready, from the first update on; nothing is kept for absent ones."""
    fleet = make_fleet(3, "a")
    assert wanted(fleet) == {0: 6}
    fleet.join("b", "native", 0.0)
    fleet.record_heartbeat(heartbeat(1, "b", "compiling"), 0.0)
    assert wanted(fleet) == {0: 6, 1: 0}
    fleet.record_heartbeat(heartbeat(1, "b", "waiting"), 0.0)
    assert wanted(fleet) == {0: 3, 1: 3}
    assert fleet.release_reserved() == []
    fleet.remove("a")
    assert wanted(fleet) == {1: 6}


def test_what_a_lost_actor_brought_is_used() -> None:
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(1, "b", 0))
    fleet.remove("b")
    assert wanted(fleet) == {0: 4}
    push(fleet, rollout(0, "a", 0))
    assert used(fleet) == [("a", 0), ("b", 0)]


def test_it_says_what_it_waits_for() -> None:
    fleet = make_fleet(3, "a", "b")
    push(fleet, rollout(1, "b", 0))
    fleet.record_heartbeat(heartbeat(0, "a", "collecting", state_s=4.2), 0.0)
    assert fleet.waiting_for(0.0) == ("waiting for 2 of 3 rollouts: slot 0 collecting 4 s, slot 2 has no actor yet")


def test_rollouts_of_a_log_are_used_first() -> None:
    """Those that no update had used when the run was interrupted join the queue; too old ones are given back."""
    fleet = make_fleet(2, "a", "b")
    old, kept = rollout(0, "z", 7, policy_version=3), rollout(1, "y", 8, policy_version=4)
    assert fleet.begin(5, settled=[old, kept]) == [old]
    assert wanted(fleet) == {0: 2, 1: 1}
    push(fleet, rollout(0, "a", 0, policy_version=5))
    assert used(fleet) == [("a", 0), ("y", 8)]
