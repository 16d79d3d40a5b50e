"""The fleet of a resumed run: slots that go on where they were, and work that is compared instead of logged."""

from __future__ import annotations

import dataclasses

import numpy as np
from samples import RUN, heartbeat, rollout

from common.wire.messages import ACCEPTED
from common.wire.rollout import Rollout
from services.learner.scheduling.fleet import Fleet
from services.learner.scheduling.slots import Start

STARTS = (Start(0, 5, b"environments of slot 0"), Start(2, 3, b"environments of slot 1"))


def made(slot: int, incarnation: str, seq: int, version: int = 10, **changes: object) -> Rollout:
    generation = STARTS[slot].generation
    return dataclasses.replace(
        rollout(slot, "x", seq, version), incarnation=incarnation, generation=generation, **changes
    )


def resumed(logged: list[Rollout] | None = None) -> Fleet:
    """Version 10 is collected by "a" and "b", who are ready; by default the log has the rollouts of both slots."""
    fleet = Fleet(RUN, 2, STARTS)
    fleet.begin(10, logged=[made(0, "old", 5), made(1, "old", 3)] if logged is None else logged)
    for slot, incarnation in enumerate("ab"):
        fleet.join(incarnation, "native", 0.0)
        fleet.record_heartbeat(heartbeat(slot, incarnation), 0.0)
    return fleet


def push(fleet: Fleet, rollout: Rollout) -> None:
    assert fleet.admit(rollout) is None
    fleet.accept(rollout)


def test_slots_keep_generation_and_number() -> None:
    """Whoever takes a slot goes on as the one before, and is given its environments."""
    fleet = resumed()
    assert [(member.generation, member.next_seq) for _, member in fleet.members()] == [(0, 5), (2, 3)]
    assert fleet.starts_from(1) == b"environments of slot 1"
    assert fleet.given() == [1, 3]


def test_a_slot_that_is_resumed_is_waited_for() -> None:
    """Nobody else does its work, though it had holders before."""
    fleet = Fleet(RUN, 2, STARTS)
    fleet.begin(10)
    fleet.join("a", "native", 0.0)
    fleet.record_heartbeat(heartbeat(0, "a"), 0.0)
    assert fleet.orders(digest="d", size=7, t_ns=3).collect == {0: 1}
    assert fleet.waiting_for(0.0).endswith("slot 1 has no actor yet")


def test_who_leaves_before_a_rollout_changes_nothing() -> None:
    """The next one starts from the same environments; after a rollout it starts as the next generation."""
    fleet = resumed([])
    fleet.remove("b")
    assert fleet.join("c", "native", 0.0).number == 1
    assert fleet.starts_from(1) == b"environments of slot 1"
    push(fleet, made(1, "c", 3))
    assert fleet.starts_from(1) is None
    fleet.remove("c")
    fleet.join("d", "native", 0.0)
    assert [(member.generation, member.next_seq) for _, member in fleet.members()] == [(0, 5), (3, 0)]


def test_what_the_log_has_is_accepted_without_being_logged() -> None:
    """Those of the log make the batch, whatever the order they are made again in."""
    old = [made(0, "old", 5), made(1, "old", 3)]
    fleet = resumed(old)
    assert fleet.admit(made(1, "b", 3)) == ACCEPTED
    assert fleet.take() is None
    assert fleet.admit(made(0, "a", 5)) == ACCEPTED
    assert fleet.divergence is None
    taken = fleet.take()
    assert taken is not None
    assert [one is before for one, before in zip(taken, old, strict=True)] == [True, True]
    # A repeat is one as ever.
    assert fleet.admit(made(0, "a", 5)) == ACCEPTED
    assert fleet.counts.repeated == 1


def test_of_the_last_version_the_rest_is_new() -> None:
    """One rollout was logged before the end: it is compared; the other is logged."""
    fleet = resumed([made(0, "old", 5)])
    push(fleet, made(1, "b", 3))
    assert fleet.admit(made(0, "a", 5)) == ACCEPTED
    taken = fleet.take()
    assert taken is not None
    assert [one.incarnation for one in taken] == ["old", "b"]


def test_a_difference_is_a_departure() -> None:
    """It is told with what differs, and nothing more is taken until the fleet starts over."""
    fleet = resumed()
    reward = made(0, "a", 5).reward + np.float32(1)
    assert fleet.admit(made(0, "a", 5, reward=reward)) == ACCEPTED
    assert fleet.divergence is not None
    assert fleet.divergence.startswith("rollout 5 of slot 0, version 10: reward[0, 0] is ")
    answer = fleet.admit(made(1, "b", 3))
    assert answer is not None
    assert answer.slug == "stale"


def test_a_loss_while_acting_again_is_a_departure() -> None:
    """A successor begins with new environments, and would not make what is logged."""
    fleet = resumed()
    fleet.admit(made(0, "a", 5))
    fleet.remove("a")
    assert fleet.divergence == "slot 0 lost its actor before all was made again"
    # It stays one as long as there is something to be made again.
    fleet.begin(11, logged=[made(0, "old", 6, 11), made(1, "old", 4, 11)])
    assert fleet.divergence is not None
    fleet.begin(12)
    assert fleet.divergence is None
    # Later it is an ordinary loss.
    later = resumed([])
    push(later, made(0, "a", 5))
    later.remove("a")
    assert later.divergence is None


def test_starting_over_frees_every_slot() -> None:
    """Actors are not named any more, so that they join again, as new generations; what was accepted stays good."""
    old = made(0, "old", 5)
    fleet = resumed([old])
    push(fleet, made(1, "b", 3))
    fleet.admit(made(0, "a", 5, reward=old.reward + np.float32(1)))
    fleet.start_over((Start(1), Start(3)), [old], collect=True)
    assert fleet.divergence is None
    assert fleet.orders(digest="d", size=7, t_ns=3).collect == {}
    taken = fleet.take()
    assert taken is not None
    assert [one.incarnation for one in taken] == ["old", "b"]
    assert fleet.join("c", "native", 0.0).number == 0
    assert fleet.members()[0][1].generation == 1


def test_settled_rollouts_are_not_made_again() -> None:
    """Their slots have nothing to do; the others are waited for."""
    fleet = Fleet(RUN, 2, (Start(1), Start(3)))
    old = made(0, "old", 5)
    fleet.begin(10, settled=[old])
    for slot, incarnation in enumerate("ab"):
        fleet.join(incarnation, "native", 0.0)
        fleet.record_heartbeat(heartbeat(slot, incarnation), 0.0)
    assert fleet.orders(digest="d", size=7, t_ns=3).collect == {0: 0, 1: 1}
    push(fleet, dataclasses.replace(rollout(1, "b", 0, 10), generation=3))
    taken = fleet.take()
    assert taken is not None
    assert [one.id for one in taken] == [(0, 0, 5), (1, 3, 0)]


def test_while_nothing_is_collected_nothing_is_taken() -> None:
    """The log is gone through without the actors: what one sends is of no use."""
    fleet = resumed()
    fleet.admit(made(0, "a", 5))
    fleet.remove("a")
    fleet.start_over((Start(1), Start(3)), [], collect=False)
    fleet.join("c", "native", 0.0)
    answer = fleet.admit(dataclasses.replace(rollout(0, "c", 0, 10), generation=1))
    assert answer is not None
    assert answer.slug == "surplus"
