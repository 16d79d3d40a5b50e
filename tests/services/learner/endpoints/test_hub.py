"""The hub: joining, leaving, and what the learner tells, over real sessions on loopback."""

from __future__ import annotations

from collections.abc import Callable
from queue import Queue
from typing import Any

import pytest
from hub_sides import DEADLINE_S, KEYS, Actor, Learner
from samples import RUN, STATUS_NOW, evaluation, heartbeat, question, rollout, snapshot

from common.config.sources import parse_json
from common.wire import codec
from common.wire.keys import JOIN
from common.wire.messages import JoinReply, Orders, PushReply, Snapshot
from services.learner.endpoints import hub, joins
from services.learner.training.snapshots import make_snapshot

# -- joining -----------------------------------------------------------------------------------------------


def test_joining_gives_slot_run_and_settings(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """All that an actor needs is in the answer; the learner's user is told who came."""
    learner, actor = learners(seed=5), actors()
    first, second = actor.join("a"), actor.join("b", run=RUN)
    assert (first.accepted, first.run, first.slot, first.generation) == (True, RUN, 0, 0)
    assert (second.accepted, second.run, second.slot, second.generation) == (True, RUN, 1, 0)
    assert parse_json(first.settings) == learner.settings
    assert learner.events.get(timeout=DEADLINE_S) == (
        "info",
        "actor_joined",
        "slot 0 (generation 0): native on here, incarnation a",
    )
    assert learner.hub.actors() == 2


def test_another_schema_is_refused_for_good(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """With a sentence that says what to do, in the learner's own schema."""
    learners()
    other = codec.encode(codec.decode(question().encode()) | {"schema": 999, "field_of_the_future": 1})
    reply = JoinReply.decode(actors().ask(JOIN, other))
    assert (reply.accepted, reply.final) == (False, True)
    assert reply.text == (
        f"Join of schema 999, but this side speaks schema {codec.SCHEMA_VERSION}: "
        "run the same release on the learner and on the actors"
    )


def test_a_question_that_is_none_is_refused_for_good(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """The same bytes would be no better the next time."""
    learner = learners()
    reply = JoinReply.decode(actors().ask(JOIN, b"hello"))
    assert (reply.accepted, reply.final) == (False, True)
    assert "not a message" in reply.text
    assert learner.hub.refusals() == {"not_msgpack": 1}


def test_another_run_is_refused_for_good(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """An actor that was told to work for one run works for no other."""
    learners()
    reply = actors().join(run="run-2")
    assert (reply.accepted, reply.final) == (False, True)
    assert reply.text == "this learner runs 'run-1', not 'run-2'"


def test_a_full_run_is_refused_for_now(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """An actor more than there are slots stands by."""
    learners(actors=1, num_envs=2)
    actor = actors()
    actor.join("a")
    reply = actor.join("b")
    assert (reply.accepted, reply.final) == (False, False)
    assert reply.text == "all 1 slots are taken; this actor stands by and takes over when one is freed"


def test_a_finished_run_is_refused_for_good(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """There is nothing to do any more."""
    learner, actor = learners(), actors()
    learner.hub.finish()
    reply = actor.join()
    assert (reply.accepted, reply.final) == (False, True)
    assert reply.finished
    assert reply.finished
    assert reply.text == "the run is over, nothing is left to do for run 'run-1'"


def test_who_stands_by_is_known_until_it_has_asked_again(
    learners: Callable[..., Learner],
    actors: Callable[[], Actor],
    until: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So that a learner that leaves can wait for it to hear that the run is over. A wrong run is no standing by."""
    monkeypatch.setattr(joins, "ASK_AGAIN_S", 0.2)
    learner, actor = learners(actors=1, num_envs=2), actors()
    actor.join("a")
    actor.join("b", run="another")
    assert not learner.hub.standing_by()
    actor.join("b")
    assert learner.hub.standing_by()
    until(lambda: not learner.hub.standing_by())


def test_slots_without_an_actor_are_released_after_their_time(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """The one that is there is told to do the work, and the user is told why."""
    learner, actor = learners(slot_wait_s=0.001), actors()
    heard: list[Orders] = []
    actor.session.subscribe(KEYS.policy_notify, lambda key, data: heard.append(Orders.decode(data)))
    actor.join("a")
    learner.events.get(timeout=DEADLINE_S)
    until(lambda: (learner.hub.announce(), bool(heard))[1])
    learner.hub.release_reserved()
    until(lambda: heard[-1].collect == {0: 2})
    text = "no actor after 0.001 s in slot 1: others do its work"
    assert learner.events.get(timeout=DEADLINE_S) == ("info", "slots_released", text)


@pytest.mark.parametrize("wait_s", [None, 3600.0])
def test_slots_are_waited_for_until_then(
    learners: Callable[..., Learner], actors: Callable[[], Actor], wait_s: float | None
) -> None:
    """For ever, if no time is set."""
    learner, actor = learners(slot_wait_s=wait_s), actors()
    actor.join("a")
    learner.hub.release_reserved()
    assert "slot 1 has no actor yet" in learner.hub.waiting_for()
    assert [learner.events.get(timeout=DEADLINE_S)[1], learner.events.empty()] == ["actor_joined", True]


@pytest.mark.parametrize(("asked", "found"), [("auto", {"mjx"}), ("native", {"native"})])
def test_engines_are_those_that_work(
    learners: Callable[..., Learner], actors: Callable[[], Actor], asked: str, found: set[str]
) -> None:
    """An actor's own engine counts only where the run leaves the choice to it."""
    learner = learners(physics=asked)
    actors().join(physics="mjx")
    assert learner.hub.engines() == found


# -- who is there ------------------------------------------------------------------------------------------


def test_an_actor_whose_session_closes_is_lost(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Its slot is free at once, the next one in it is the next generation, and the user is told."""
    learner, actor, other = learners(), actors(), actors()
    actor.join("a")
    other.join("b")
    actor.session.declare_alive(KEYS.alive("actor", "a"))
    actor.session.close()
    until(lambda: learner.hub.actors() == 1)
    reply = other.join("c")
    assert (reply.slot, reply.generation) == (0, 1)
    told = [learner.events.get(timeout=DEADLINE_S) for _ in range(4)]
    assert told[2] == ("warning", "actor_lost", "slot 0: a is gone")


def test_actors_that_leave_after_the_end_are_not_lost(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Their slots are freed without a warning."""
    learner, actor = learners(), actors()
    actor.join("a")
    actor.session.declare_alive(KEYS.alive("actor", "a"))
    learner.events.get(timeout=DEADLINE_S)
    learner.hub.finish()
    actor.session.close()
    until(lambda: learner.hub.actors() == 0)
    assert learner.events.empty()


def test_a_silent_actor_is_dropped(
    learners: Callable[..., Learner], actors: Callable[[], Actor], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An actor that is connected and sends no heartbeat loses its slot; who beats stays."""
    learner, actor = learners(), actors()
    actor.join("a")
    learner.events.get(timeout=DEADLINE_S)
    learner.hub.drop_silent()
    assert learner.hub.actors() == 1
    monkeypatch.setattr(hub, "SILENT_S", -1.0)
    learner.hub.drop_silent()
    assert learner.hub.actors() == 0
    assert learner.events.get(timeout=DEADLINE_S)[1] == "actor_lost"
    assert actor.push(rollout()).slug == "incarnation"


# -- what the learner tells --------------------------------------------------------------------------------


def test_a_late_joiner_gets_the_snapshot_as_it_was_published(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """The newest one, byte for byte, whenever it is asked for."""
    learner, actor = learners(), actors()
    assert actor.ask(KEYS.policy_latest, b"") == snapshot(0).encode()
    published = learner.hub.publish(snapshot(1))
    served = actor.ask(KEYS.policy_latest, b"")
    assert served == published
    assert Snapshot.decode(served).version == 1


def test_orders_tell_the_newest_snapshot_and_what_is_wanted(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Said when a version begins, when an actor is ready or lost, and when the run is over."""
    learner, actor = learners(), actors()
    heard: list[Orders] = []
    actor.session.subscribe(KEYS.policy_notify, lambda key, data: heard.append(Orders.decode(data)))
    actor.join("a")
    actor.join("b")

    def said(**wanted: Any) -> Callable[[], bool]:
        def is_said() -> bool:
            learner.hub.announce()
            return bool(heard) and all(getattr(heard[-1], name) == value for name, value in wanted.items())

        return is_said

    until(said(version=0, collect={0: 1, 1: 1}))
    data = learner.hub.publish(snapshot(1), collect=False)
    until(said(version=1, digest=snapshot(1).digest, size=len(data), collect={0: 0, 1: 0}))
    beats = actor.session.publisher(KEYS.heartbeat(1))
    learner.hub.ask_for_evaluation(8)
    # Nobody is ready, until slot 1 says so; from then on orders are said without being repeated.
    beats.put(heartbeat(1, "b", "waiting").encode())
    until(lambda: heard[-1].evaluate == {1: 8})
    learner.hub.finish()
    until(lambda: heard[-1].finished)


def test_metrics_and_status_are_published(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """For whoever subscribes."""
    learner, actor = learners(), actors()
    heard: Queue[tuple[str, bytes]] = Queue()
    actor.session.subscribe(KEYS.metrics, lambda *sample: heard.put(sample))
    actor.session.subscribe(KEYS.status, lambda *sample: heard.put(sample))
    wanted = {(KEYS.metrics, b'{"a":1}'), (KEYS.status, STATUS_NOW.encode())}
    found: set[tuple[str, bytes]] = set()

    def both() -> bool:
        # Until the subscriptions have reached the learner, what it publishes goes to nobody.
        learner.hub.publish_metrics(b'{"a":1}')
        learner.hub.publish_progress(STATUS_NOW)
        while not heard.empty():
            found.add(heard.get())
        return found == wanted

    until(both)


def test_malformed_heartbeats_are_counted(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """And do no harm."""
    learner, actor = learners(), actors()
    beats = actor.session.publisher(KEYS.heartbeat(0))

    def counted() -> bool:
        beats.put(b"hello")
        return learner.hub.refusals().get("not_msgpack", 0) > 0

    until(counted)
    assert actor.join().accepted


# -- the evaluation ----------------------------------------------------------------------------------------


def test_an_evaluation_is_taken_from_who_holds_the_slot(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """Of the version that is wanted; a repeat is accepted, anything else refused."""
    learner, actor = learners(), actors()
    actor.join("a")
    learner.hub.publish(snapshot(3))
    early = PushReply.decode(actor.ask(KEYS.evaluation(0), evaluation(0, "a", 3).encode()))
    assert (early.slug, early.text) == ("stale", "this evaluation was not asked for")
    learner.hub.ask_for_evaluation(2)

    def push(*place: Any) -> PushReply:
        return PushReply.decode(actor.ask(KEYS.evaluation(0), evaluation(*place).encode()))

    for place in ((0, "a", 2), (0, "stranger", 3), (1, "a", 3)):
        assert push(*place) == PushReply.refused("stale", "this evaluation was not asked for"), place
    assert PushReply.decode(actor.ask(KEYS.evaluation(0), b"hello")).slug == "not_msgpack"
    assert learner.hub.evaluation(0.0) is None
    assert push(0, "a", 3).status == "accepted"
    assert push(0, "a", 3).status == "accepted"
    found = learner.hub.evaluation(0.0)
    assert found is not None
    assert (found.version, found.episode_return.tolist(), found.episode_length.tolist()) == (3, [10, 30], [5, 7])


def test_a_snapshot_carries_the_digest_of_its_arrays() -> None:
    """What an actor decodes, it can trust."""
    arrays = snapshot(4).arrays
    made = make_snapshot(RUN, 4, arrays)
    assert Snapshot.decode(made.encode()).digest == snapshot(4).digest
