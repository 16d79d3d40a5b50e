"""The fleet: slots, what is asked of whom, and which rollouts count."""

from __future__ import annotations

import pytest
from samples import RUN, heartbeat, rollout

from common.errors import RefusedError
from common.wire.messages import ACCEPTED, Orders
from common.wire.rollout import Rollout
from services.learner.scheduling.fleet import Fleet
from services.learner.scheduling.slots import REMEMBERED


def make_fleet(slots: int, *incarnations: str) -> Fleet:
    """A fleet at version 0 whose first actors, one a slot in the order given, are ready."""
    fleet = Fleet(RUN, slots)
    fleet.begin(0)
    for number, incarnation in enumerate(incarnations):
        fleet.join(incarnation, "native", 0.0)
        fleet.record_heartbeat(heartbeat(number, incarnation), 0.0)
    return fleet


def push(fleet: Fleet, made: Rollout) -> None:
    """Bring in a rollout that must be admitted."""
    assert fleet.admit(made) is None
    fleet.accept(made)


def orders(fleet: Fleet) -> Orders:
    return fleet.orders(digest="d", size=7, t_ns=3)


def returned(fleet: Fleet, slot: int, incarnation: str) -> None:
    """A new actor in that slot, still compiling."""
    assert fleet.join(incarnation, "native", 0.0).number == slot
    fleet.record_heartbeat(heartbeat(slot, incarnation, "compiling"), 0.0)


# -- joining and leaving -----------------------------------------------------------------------------------


def test_the_lowest_free_slot_is_given_out() -> None:
    """Actors get slots 0, 1, 2 in the order they come; one that comes later gets the lowest that was freed."""
    fleet = Fleet(RUN, 3)
    assert [fleet.join(name, "native", 0.0).number for name in "abc"] == [0, 1, 2]
    fleet.remove("c")
    fleet.remove("a")
    assert fleet.join("d", "native", 0.0).number == 0
    assert fleet.join("e", "native", 0.0).number == 2


def test_a_full_fleet_refuses() -> None:
    """Without a free slot an actor is refused, and told that it stands by."""
    fleet = make_fleet(2, "a", "b")
    with pytest.raises(RefusedError, match="all 2 slots are taken; this actor stands by"):
        fleet.join("c", "native", 0.0)
    assert fleet.counts.joined == 2


def test_joining_twice_gives_the_same_slot() -> None:
    """An actor whose answer got lost asks again under its name and gets the slot it has."""
    fleet = make_fleet(2, "a", "b")
    again = fleet.join("b", "native", 0.0)
    assert (again.number, again.given) == (1, 1)
    assert fleet.counts.joined == 2


def test_generations_count_how_often_a_slot_was_given_out() -> None:
    """A slot's generation is 0 for its first holder and one more for each that follows; other slots do not count."""
    fleet = make_fleet(2, "a", "b")
    generations = []
    for old, new in (("a", "c"), ("c", "d")):
        fleet.remove(old)
        slot = fleet.join(new, "native", 0.0)
        assert slot.member is not None
        generations.append((slot.number, slot.member.generation))
    assert generations == [(0, 1), (0, 2)]
    assert [member.generation for _, member in fleet.members()] == [2, 0]


def test_an_incarnation_that_lost_its_slot_does_not_come_back() -> None:
    """A name is good for one life: else a rollout of the first one could be counted again in the second."""
    fleet = make_fleet(1, "a")
    fleet.remove("a")
    with pytest.raises(RefusedError, match="'a' has lost its slot; join as another incarnation"):
        fleet.join("a", "native", 0.0)
    assert fleet.join("b", "native", 0.0).number == 0


def test_losing_frees_the_slot_once() -> None:
    """Losing an actor names its slot; losing it again, or one that was never here, does nothing."""
    fleet = make_fleet(2, "a", "b")
    lost = fleet.remove("b")
    assert lost is not None
    assert (lost.number, lost.member) == (1, None)
    assert fleet.remove("b") is None
    assert fleet.remove("stranger") is None
    assert fleet.counts.lost == 1
    assert [number for number, _ in fleet.members()] == [0]


def test_silent_actors() -> None:
    """An actor is silent once its last sign of life, joining or a heartbeat, is longer ago than the limit."""
    fleet = Fleet(RUN, 3)
    fleet.join("a", "native", 100.0)
    fleet.join("b", "native", 100.0)
    fleet.record_heartbeat(heartbeat(1, "b"), 125.0)
    fleet.record_heartbeat(heartbeat(0, "stranger"), 130.0)  # not a's
    # a: last heard at 100, b at 125
    assert fleet.silent(130.0, 30.0) == []
    assert fleet.silent(130.5, 30.0) == ["a"]
    assert fleet.silent(155.5, 30.0) == ["a", "b"]


def test_heartbeats_tell_when_orders_change() -> None:
    """Only becoming ready (or compiling again) changes orders; a beat of a stranger or of another slot is ignored."""
    fleet = Fleet(RUN, 2)
    fleet.join("a", "native", 0.0)
    assert not fleet.record_heartbeat(heartbeat(0, "a", "compiling"), 1.0)
    assert fleet.record_heartbeat(heartbeat(0, "a", "waiting"), 2.0)
    assert not fleet.record_heartbeat(heartbeat(0, "a", "collecting", version=4, env_steps=600, steps_per_s=50.0), 3.0)
    assert not fleet.record_heartbeat(heartbeat(0, "stranger", "compiling"), 4.0)
    assert not fleet.record_heartbeat(heartbeat(1, "a", "compiling"), 4.0)
    assert not fleet.record_heartbeat(heartbeat(99, "a", "compiling"), 4.0)
    ((_, member),) = fleet.members()
    assert (member.state, member.heard_s, member.version) == ("collecting", 3.0, 4)
    assert (member.env_steps, member.steps_per_s) == (600, 50.0)


def test_holds() -> None:
    """A slot is held by the incarnation that it was given to, until that is lost."""
    fleet = make_fleet(2, "a", "b")
    assert fleet.holds(0, "a")
    assert not fleet.holds(1, "a")
    assert not fleet.holds(5, "a")
    fleet.remove("a")
    assert not fleet.holds(0, "a")


# -- the rollouts of a version -----------------------------------------------------------------------------


def test_a_batch_is_complete_with_one_rollout_a_slot() -> None:
    """Nothing is given out before every slot's rollout is in the log; then all are, in the order of the slots."""
    fleet = make_fleet(3, "a", "b", "c")
    made = {name: rollout(slot, name) for slot, name in enumerate("abc")}
    push(fleet, made["c"])
    push(fleet, made["a"])
    assert fleet.admit(made["b"]) is None
    assert fleet.take() is None  # admitted, and not yet in the log
    fleet.accept(made["b"])
    taken = fleet.take()
    assert taken is not None
    assert [r.incarnation for r in taken] == ["a", "b", "c"]


def test_the_order_of_a_batch_is_slot_then_generation_then_seq() -> None:
    """The order depends on who made what, not on when it came."""
    fleet = make_fleet(4, "a", "z", "c", "d")
    # z delivers its first rollout and is lost; b takes slot 1 over; a and b share the work of slots 2 and 3, lost too.
    push(fleet, rollout(1, "z"))
    fleet.remove("z")
    fleet.remove("c")
    fleet.remove("d")
    returned(fleet, 1, "b")
    fleet.record_heartbeat(heartbeat(1, "b"), 0.0)  # ready: the work of slots 2 and 3 is divided among a and b
    for made in (rollout(1, "b", 0, generation=1), rollout(0, "a", 0), rollout(0, "a", 1)):
        push(fleet, made)
    taken = fleet.take()
    assert taken is not None
    # (slot, generation, seq): a = (0, 0, 0) and (0, 0, 1), z = (1, 0, 0), b = (1, 1, 0)
    assert [(r.incarnation, r.seq) for r in taken] == [("a", 0), ("a", 1), ("z", 0), ("b", 0)]


def test_the_generation_is_the_one_that_was_given() -> None:
    """Environments of another life of the slot are no part of this one's place in the batch."""
    fleet = make_fleet(1, "a")
    answer = fleet.admit(rollout(0, "a", generation=1))
    assert answer is not None
    assert (answer.status, answer.slug, answer.text) == ("refused", "generation", "'a' has generation 0, not 1")
    assert fleet.counts.refused == {"generation": 1}


def test_stale_rollouts_are_refused_and_counted() -> None:
    """A rollout of an older, or a not yet published, policy is of no use; the answer names both versions."""
    fleet = make_fleet(1, "a")
    fleet.begin(5)
    old, new = fleet.admit(rollout(policy_version=4)), fleet.admit(rollout(policy_version=6))
    assert old is not None
    assert new is not None
    assert (old.status, old.slug, old.text) == ("refused", "stale", "made with policy 4; policy 5 is wanted")
    assert (new.status, new.slug, new.text) == ("refused", "stale", "made with policy 6; policy 5 is wanted")
    assert fleet.counts.refused == {"stale": 2}


def test_surplus_rollouts_are_refused_and_counted() -> None:
    """Once as many rollouts are taken or on their way to the log as a batch holds, another is of no use."""
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(0, "a", 0))
    assert fleet.admit(rollout(1, "b", 0)) is None
    extra = fleet.admit(rollout(0, "a", 1))
    assert extra is not None
    assert (extra.status, extra.slug, extra.text) == ("refused", "surplus", "policy 0 has all the rollouts it needs")
    assert fleet.counts.refused == {"surplus": 1}


def test_a_gap_is_refused_and_counted() -> None:
    """A rollout that skips one would start from states that the learner never saw."""
    fleet = make_fleet(2, "a", "b")
    answer = fleet.admit(rollout(0, "a", 1))
    assert answer is not None
    assert (answer.status, answer.slug, answer.text) == ("refused", "gap", "rollout 1 came where 0 is next")
    assert fleet.counts.refused == {"gap": 1}


def test_rollouts_of_who_holds_no_slot_are_refused_and_counted() -> None:
    """A stranger, an actor that was lost, one that names another's slot and one beyond the slots are told to join."""
    fleet = make_fleet(2, "a", "b")
    fleet.remove("b")
    for slot, incarnation in ((0, "stranger"), (1, "b"), (1, "a"), (7, "a")):
        answer = fleet.admit(rollout(slot, incarnation))
        assert answer is not None
        assert answer.status == "refused"
        assert (answer.slug, answer.text) == ("incarnation", f"slot {slot} is not held by {incarnation!r}; join again")
    assert fleet.counts.refused == {"incarnation": 4}


def test_rollouts_of_another_run_are_refused_and_counted() -> None:
    """The run in the message counts, not only the key it came on."""
    fleet = make_fleet(1, "a")
    answer = fleet.admit(rollout(run="run-2"))
    assert answer is not None
    assert (answer.status, answer.slug, answer.text) == ("refused", "run", "this learner runs 'run-1', not 'run-2'")
    assert fleet.counts.refused == {"run": 1}


def test_a_repeat_is_accepted_and_used_once() -> None:
    """Sent again: busy until the first is in the log, accepted from then on (also versions later), and used once."""
    fleet = make_fleet(2, "a", "b")
    made = rollout(0, "a")
    assert fleet.admit(made) is None
    under_way = fleet.admit(made)
    assert under_way is not None
    assert under_way.status == "busy"
    fleet.accept(made)
    assert fleet.admit(made) == ACCEPTED
    push(fleet, rollout(1, "b"))
    taken = fleet.take()
    assert taken is not None
    assert [r.key for r in taken] == [(0, "a", 0), (1, "b", 0)]
    fleet.begin(1)
    assert fleet.admit(made) == ACCEPTED
    assert fleet.take() is None
    assert fleet.counts.repeated == 2
    assert not fleet.counts.refused


def test_a_rollout_that_reaches_the_log_after_its_version_is_not_used() -> None:
    """What was admitted for one version does not count for the next."""
    fleet = make_fleet(1, "a")
    made = rollout()
    assert fleet.admit(made) is None
    fleet.begin(1)
    fleet.accept(made)
    assert fleet.take() is None


def test_rollouts_of_a_lost_actor_stay_good() -> None:
    """What was accepted, or under way, when its actor went is used."""
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(0, "a"))
    under_way = rollout(1, "b")
    assert fleet.admit(under_way) is None
    fleet.remove("a")
    fleet.remove("b")
    fleet.accept(under_way)
    taken = fleet.take()
    assert taken is not None
    assert [r.incarnation for r in taken] == ["a", "b"]


# -- orders ------------------------------------------------------------------------------------------------


def test_orders_while_collecting() -> None:
    """Each actor is asked for one rollout; the orders carry run, version, digest, size and time."""
    fleet = make_fleet(2, "a", "b")
    fleet.begin(3)
    assert orders(fleet) == Orders(RUN, 3, "d", 7, {0: 1, 1: 1}, {}, False, 3)


def test_a_slot_never_held_is_waited_for() -> None:
    """A run's first batch has a rollout of every slot, whoever is late: nobody is asked for another's."""
    fleet = make_fleet(3, "a")
    assert orders(fleet).collect == {0: 1}
    push(fleet, rollout(0, "a"))
    assert orders(fleet).collect == {0: 1}
    fleet.begin(1)
    assert orders(fleet).collect == {0: 1}


def test_a_first_actor_that_still_compiles_is_waited_for() -> None:
    """The first actor of a slot is asked for its rollout from the start, ready or not."""
    fleet = make_fleet(2, "a")
    fleet.join("b", "native", 0.0)
    assert orders(fleet).collect == {0: 1, 1: 1}


def test_a_slot_never_held_is_left_to_the_others_once_excused() -> None:
    """Slots 1 and 2 of 3 have had no actor when the wait ends: slot 0 makes 3 rollouts. Excused once, told once."""
    fleet = make_fleet(3, "a")
    assert fleet.release_reserved() == [1, 2]
    assert orders(fleet).collect == {0: 3}
    assert fleet.release_reserved() == []


def test_one_that_comes_late_is_used_when_it_is_ready() -> None:
    """Nobody waits for it to compile; then the work is shared: 2 for slot 0, which also does slot 2's, 1 for slot 1."""
    fleet = make_fleet(3, "a")
    fleet.release_reserved()
    returned(fleet, 1, "b")
    assert orders(fleet).collect == {0: 3, 1: 1}
    fleet.record_heartbeat(heartbeat(1, "b"), 0.0)
    assert orders(fleet).collect == {0: 2, 1: 1}


def test_an_actor_that_came_in_time_is_not_excused() -> None:
    """It holds its slot and still compiles when the wait ends: its first rollout is waited for."""
    fleet = make_fleet(2, "a")
    fleet.join("b", "native", 0.0)
    assert fleet.release_reserved() == []
    assert orders(fleet).collect == {0: 1, 1: 1}


def test_the_work_of_a_lost_actor_is_handed_to_the_others() -> None:
    """Orphaned slots are shared out in turn, beginning with the lowest slot that has an actor."""
    fleet = make_fleet(5, *"abcde")
    for gone in "bde":  # slots 1, 3 and 4: one each for slots 0 and 2, then slot 0 again
        fleet.remove(gone)
    assert orders(fleet).collect == {0: 3, 2: 2}


def test_the_work_of_a_slot_that_has_delivered_is_not_handed_on() -> None:
    """A slot lost after its rollout came is complete for this version, and orphaned for the next."""
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(1, "b"))
    fleet.remove("b")
    assert orders(fleet).collect == {0: 1}
    push(fleet, rollout(0, "a"))
    fleet.begin(1)
    assert orders(fleet).collect == {0: 2}


def test_a_returning_actor_gets_its_work_back_when_it_is_ready() -> None:
    """While an actor that took over a lost slot compiles, the others go on doing its work."""
    fleet = make_fleet(2, "a", "b")
    fleet.remove("b")
    assert orders(fleet).collect == {0: 2}
    returned(fleet, 1, "c")
    assert orders(fleet).collect[0] == 2
    assert fleet.record_heartbeat(heartbeat(1, "c", "waiting"), 0.0)
    assert orders(fleet).collect == {0: 1, 1: 1}


def test_with_nobody_left_the_first_to_return_does_all_the_work() -> None:
    """A run whose actors all went goes on with the first that is ready again."""
    fleet = make_fleet(3, *"abc")
    for gone in "abc":
        fleet.remove(gone)
    assert orders(fleet).collect == {}
    returned(fleet, 0, "d")
    fleet.record_heartbeat(heartbeat(0, "d", "waiting"), 0.0)
    assert orders(fleet).collect == {0: 3}


def test_the_last_version_needs_no_rollouts() -> None:
    """Nobody is asked for one, and what is sent all the same is surplus."""
    fleet = make_fleet(2, "a", "b")
    fleet.begin(9, collect=False)
    assert orders(fleet).collect == {0: 0, 1: 0}
    answer = fleet.admit(rollout(policy_version=9))
    assert answer is not None
    assert answer.slug == "surplus"


def test_orders_while_evaluating() -> None:
    """One ready actor, that of the lowest slot, is asked for the episodes; nobody for rollouts."""
    fleet = Fleet(RUN, 3)
    fleet.begin(9, collect=False)
    for name in "abc":
        fleet.join(name, "native", 0.0)
    fleet.record_heartbeat(heartbeat(1, "b"), 0.0)
    fleet.record_heartbeat(heartbeat(2, "c"), 0.0)
    fleet.evaluate(64)
    said = orders(fleet)
    assert (said.version, said.collect, said.evaluate, said.finished) == (9, {0: 0, 1: 0, 2: 0}, {1: 64}, False)


def test_a_lost_evaluator_is_replaced() -> None:
    """By the next that is ready; by one that becomes ready later where there is none now."""
    fleet = make_fleet(2, "a", "b")
    fleet.evaluate(8)
    assert orders(fleet).evaluate == {0: 8}
    fleet.remove("a")
    assert orders(fleet).evaluate == {1: 8}
    fleet.remove("b")
    assert orders(fleet).evaluate == {}
    returned(fleet, 0, "c")
    assert orders(fleet).evaluate == {}
    fleet.record_heartbeat(heartbeat(0, "c", "waiting"), 0.0)
    assert orders(fleet).evaluate == {0: 8}


def test_orders_name_every_slot_that_is_held() -> None:
    """Also when it has nothing to do: an actor whose slot is not named has been given up."""
    fleet = make_fleet(3, "a", "b")
    fleet.begin(9, collect=False)
    assert set(orders(fleet).collect) == {0, 1}
    fleet.remove("a")
    assert set(orders(fleet).collect) == {1}


def test_orders_when_the_run_is_over() -> None:
    """Everybody is told so, and asked for nothing."""
    fleet = make_fleet(2, "a", "b")
    fleet.evaluate(8)
    fleet.finish()
    said = orders(fleet)
    assert (said.collect, said.evaluate, said.finished) == ({}, {}, True)
    assert fleet.finished


def test_what_the_run_waits_for() -> None:
    """The sentence names every slot without a rollout, and why there is none."""
    fleet = make_fleet(4, "a", "b", "c")
    push(fleet, rollout(0, "a"))
    fleet.record_heartbeat(heartbeat(1, "b", "collecting", state_s=12.4), 0.0)
    fleet.remove("c")
    assert fleet.waiting_for(0.0) == (
        "waiting for 3 of 4 rollouts: slot 1 collecting 12 s, slot 2 has lost its actor, slot 3 has no actor yet"
    )


def test_an_actor_cannot_supply_the_whole_batch() -> None:
    """Of two slots each is to bring one: a second rollout of slot 0 is surplus, and slot 1's is used."""
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(0, "a", 0))
    answer = fleet.admit(rollout(0, "a", 1))
    assert answer is not None
    assert (answer.status, answer.slug, answer.text) == (
        "refused",
        "surplus",
        "policy 0 needs 1 of slot 0, and has as many",
    )
    push(fleet, rollout(1, "b", 0))
    taken = fleet.take()
    assert taken is not None
    assert [made.slot for made in taken] == [0, 1]


def test_pending_rollouts_count_against_the_quota() -> None:
    """Also a rollout that is still being logged: two that are pushed at once are one too many."""
    fleet = make_fleet(2, "a", "b")
    assert fleet.admit(rollout(0, "a", 0)) is None
    answer = fleet.admit(rollout(0, "a", 1))
    assert answer is not None
    assert answer.slug == "surplus"


def test_joining_again_does_not_renew_the_quota() -> None:
    """The slot has delivered for this version: its next incarnation is asked for nothing, and what it pushes all the
    same is surplus, so the other slot's rollout is used. With the next version it is asked as ever."""
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(0, "a", 0))
    fleet.remove("a")
    returned(fleet, 0, "c")
    fleet.record_heartbeat(heartbeat(0, "c"), 0.0)
    assert orders(fleet).collect == {0: 0, 1: 1}
    answer = fleet.admit(rollout(0, "c", 0, generation=1))
    assert answer is not None
    assert answer.slug == "surplus"
    push(fleet, rollout(1, "b", 0))
    taken = fleet.take()
    assert taken is not None
    assert [made.incarnation for made in taken] == ["a", "b"]
    fleet.begin(1)
    assert orders(fleet).collect == {0: 1, 1: 1}
    push(fleet, rollout(0, "c", 0, 1, generation=1))


def test_who_was_lost_before_its_rollout_was_logged_is_replaced() -> None:
    """Its successor delivers in its place; a rollout that is still being logged counts, and comes into the batch."""
    fleet = make_fleet(2, "a", "b")
    fleet.remove("a")
    returned(fleet, 0, "c")
    fleet.record_heartbeat(heartbeat(0, "c"), 0.0)
    assert orders(fleet).collect[0] == 1
    made = rollout(0, "c", 0, generation=1)
    assert fleet.admit(made) is None
    fleet.remove("c")
    returned(fleet, 0, "d")
    fleet.record_heartbeat(heartbeat(0, "d"), 0.0)
    assert orders(fleet).collect[0] == 0
    fleet.accept(made)
    push(fleet, rollout(1, "b", 0))
    taken = fleet.take()
    assert taken is not None
    assert [one.incarnation for one in taken] == ["c", "b"]


def test_a_successor_takes_over_work_beside_what_its_slot_has_delivered() -> None:
    """Slot 0 has delivered and lost its actor, slot 1 is lost: the successor in slot 0 makes the one that is missing,
    and no second one."""
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(0, "a", 0))
    fleet.remove("a")
    fleet.remove("b")
    returned(fleet, 0, "c")
    fleet.record_heartbeat(heartbeat(0, "c"), 0.0)
    assert orders(fleet).collect == {0: 1}
    push(fleet, rollout(0, "c", 0, generation=1))
    assert fleet.take() is not None


def test_a_refused_surplus_leaves_no_trace() -> None:
    """The number of the refused rollout is still the next: the actor goes on with the next version."""
    fleet = make_fleet(2, "a", "b")
    push(fleet, rollout(0, "a", 0))
    assert fleet.admit(rollout(0, "a", 1)) is not None
    push(fleet, rollout(1, "b", 0))
    fleet.begin(1)
    assert fleet.admit(rollout(0, "a", 1, 1)) is None


def test_departed_incarnations_take_bounded_memory() -> None:
    """Of any number the newest 4,096 are remembered, and refused."""
    fleet = make_fleet(1)
    for number in range(REMEMBERED + 10):
        fleet.join(f"i{number}", "native", 0.0)
        fleet.remove(f"i{number}")
    assert len(fleet._departed) == REMEMBERED
    with pytest.raises(RefusedError, match="has lost its slot"):
        fleet.join("i10", "native", 0.0)
