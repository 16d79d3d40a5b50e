"""The hub: what it answers to whoever watches, and what it counts of messages from the wrong sender."""

from __future__ import annotations

from collections.abc import Callable

from hub_sides import DEADLINE_S, KEYS, Actor, Learner
from samples import RUN, STATUS_NOW, heartbeat, rollout

from common.wire.keys import STATUS
from common.wire.report import RunReport


def test_a_report_is_answered_to_whoever_asks(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """With the address alone: the run, what it waits for, and each actor with what became of its rollouts."""
    learner, actor = learners(), actors()

    def report() -> RunReport:
        return RunReport.decode(actor.ask(STATUS, b""))

    assert report().progress is None
    learner.hub.publish_progress(STATUS_NOW)
    actor.join("a")
    actor.session.publisher(KEYS.heartbeat(0)).put(heartbeat(0, "a", "collecting", steps_per_s=50.0).encode())
    until(lambda: report().actors[0].state == "collecting")
    assert actor.push(rollout(0, "a")).status == "accepted"
    assert actor.push(rollout(0, "a")).status == "accepted"
    assert actor.push(rollout(0, "a", seq=1, policy_version=7)).status == "refused"
    found = report()
    assert (found.run, found.task, found.slots, found.rollouts_there) == (RUN, "inverted_pendulum", 2, 1)
    assert found.progress is not None
    assert (found.progress.phase, found.progress.version, found.progress.updates) == ("training", 5, 10)
    assert found.waiting_for == "waiting for 1 of 2 rollouts: slot 1 has no actor yet"
    (there,) = found.actors
    assert (there.slot, there.incarnation, there.host, there.physics) == (0, "a", "here", "native")
    assert (there.steps_per_s, there.version) == (50.0, 0)
    assert (there.accepted, there.repeated, there.refused, there.busy) == (1, 1, 1, 0)
    assert 0.0 <= there.heard_s < DEADLINE_S
    assert found.refusals == {"rollout": {"stale": 1}}
    assert found.last_refusal is not None
    assert found.last_refusal.text == "made with policy 7; policy 0 is wanted"
    assert [(vacancy.slot, vacancy.lost) for vacancy in found.vacancies] == [(1, False)]
    # The fixture asked to join another run, once or more, to see whether the learner is there.
    assert set(found.refused_joins) == {"run"}


def test_heartbeats_of_others_are_counted(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Of another run, of one who holds no slot, on another's key: each with its reason, and none of them is heard."""
    learner, actor = learners(), actors()
    actor.join("a")
    beats = actor.session.publisher(KEYS.heartbeat(0))
    wrong = {
        "run": heartbeat(0, "a", "collecting", run="run-2"),
        "incarnation": heartbeat(0, "b", "collecting"),
        "bad_key": heartbeat(1, "a", "collecting"),
    }

    def counted() -> bool:
        for beat in wrong.values():
            beats.put(beat.encode())
        return set(learner.hub.refusals()) == set(wrong)

    until(counted)
    assert learner.hub.report().actors[0].state == "compiling"


def test_an_engine_that_there_is_not_is_refused_for_good(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """What an actor calls its engine is shown and kept, so it is one of those there are."""
    learner = learners(physics="auto")
    reply = actors().join(physics="\x1b[2J")
    assert (reply.accepted, reply.final) == (False, True)
    assert reply.text == "physics is '\\x1b[2J'; allowed: auto, mjx, native"
    assert learner.hub.refusals() == {"bad_value": 1}
    assert learner.hub.engines() == set()


def test_who_an_actor_is_cannot_move_the_terminal(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """Names come from the network and go to the screen and the log."""
    learner = learners()
    actors().join("a\x1b[2J", hardware={"host": "h\r\n" + "x" * 100})
    told = learner.events.get(timeout=DEADLINE_S)[2]
    assert told == f"slot 0 (generation 0): native on h??{'x' * 58}..., incarnation a?[2J"
