"""Environments on their way to the log and back to the slots."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hub_sides import KEYS, Actor, Learner
from samples import RUN, environment_arrays, rollout, snapshot

from common.log.reader import LogReader
from common.wire.messages import Environment, PushReply, digest_arrays
from services.learner.scheduling.slots import Start


def environment(slot: int = 0, incarnation: str = "a", seq: int = 0, **changes: Any) -> Environment:
    arrays = environment_arrays(seq)
    values = {"run": RUN, "generation": 0, "version": 4, "digest": digest_arrays(arrays), "arrays": arrays}
    return Environment(slot=slot, incarnation=incarnation, seq=seq, **values | changes)


def push(actor: Actor, given: Environment, slot: int | None = None) -> PushReply:
    key = KEYS.environment(given.slot if slot is None else slot)
    return PushReply.decode(actor.ask(key, given.encode()))


def logged(learner: Learner) -> list[bytes]:
    return [message.data for message in LogReader(learner.directory).messages({"/environment"})]


@pytest.fixture
def learner(learners: Callable[..., Learner]) -> Learner:
    """At version 4, for which it wants the environments of two slots."""
    made = learners()
    made.hub.publish(snapshot(4), hand_in=True)
    return made


@pytest.fixture
def actor(learner: Learner, actors: Callable[[], Actor]) -> Actor:
    """In slot 0 as "a", in slot 1 as "b"."""
    made = actors()
    made.join("a")
    made.join("b")
    return made


def test_states_are_logged_and_kept(learner: Learner, actor: Actor) -> None:
    """Accepted means in the log, once however often it is sent; what is kept is what was received."""
    states = [environment(0, "a"), environment(1, "b")]
    for given in (*states, states[0]):
        assert push(actor, given).status == "accepted"
    assert logged(learner) == [given.encode() for given in states]
    kept = learner.hub.environments.kept()
    assert kept is not None
    assert (kept.run, kept.version, list(kept.given)) == (RUN, 4, [1, 1])
    assert kept.states == {slot: given.encode() for slot, given in enumerate(states)}


def test_without_an_actor_a_slot_has_no_state(learner: Learner, actor: Actor) -> None:
    """The others' are kept all the same."""
    push(actor, environment(1, "b"))
    kept = learner.hub.environments.kept()
    assert kept is not None
    assert list(kept.states) == [1]


def test_with_the_next_version_they_are_forgotten(learner: Learner, actor: Actor) -> None:
    """They belong to one version; one that does not ask for them has none."""
    push(actor, environment())
    learner.hub.publish(snapshot(5), hand_in=True)
    kept = learner.hub.environments.kept()
    assert kept is not None
    assert kept.states == {}
    learner.hub.publish(snapshot(6))
    assert learner.hub.environments.kept() is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"version": 3}, "stale: environments of version 3 are not wanted now"),
        ({"incarnation": "c"}, "incarnation: slot 0 is not held by 'c'"),
        ({"run": "run-2"}, "incarnation: slot 0 is not held by 'a'"),
        ({"seq": 1}, "gap: environments at rollout 1 came where 0 is next"),
        ({"generation": 1}, "gap: "),
        ({"digest": "0"}, "bad_digest: environment of slot 0 says digest"),
    ],
)
def test_what_is_refused(learner: Learner, actor: Actor, changes: dict[str, Any], reason: str) -> None:
    """With a reason, and without a trace in the log."""
    answer = push(actor, environment(**changes))
    assert answer.status == "refused"
    assert f"{answer.slug}: {answer.text}".startswith(reason)
    assert logged(learner) == []


def test_the_key_must_be_the_slots(learner: Learner, actor: Actor) -> None:
    """A state cannot take another slot's place; bytes that are none are counted as malformed."""
    assert push(actor, environment(), slot=1).slug == "bad_key"
    answer = PushReply.decode(actor.ask(KEYS.environment(0), b"\x01"))
    assert answer.status == "refused"
    assert sum(learner.hub.refusals().values()) == 2


def test_a_version_that_wants_none_refuses(learner: Learner, actor: Actor) -> None:
    """An actor's orders tell it when."""
    learner.hub.publish(snapshot(4))
    assert push(actor, environment()).slug == "stale"


def test_a_resumed_slot_is_given_its_environments(learners: Callable[..., Learner], actors: Any) -> None:
    """Until its first rollout; whoever asks later is told by an empty answer that they are gone."""
    state = environment(0, "old", 7, generation=2)
    learner = learners(starts=(Start.of(state.encode()), Start(1)))
    actor = actors()
    first, second = actor.join("a"), actor.join("b")
    assert (first.generation, first.restore) == (2, True)
    assert (second.generation, second.restore) == (1, False)
    given = Environment.decode(actor.ask(KEYS.environment(0), b""))
    assert (given.seq, given.generation) == (7, 2)
    assert (given.arrays["bodies/q"] == state.arrays["bodies/q"]).all()
    assert actor.ask(KEYS.environment(1), b"") == b""
    learner.hub.publish(snapshot(0))
    answer = PushReply.decode(actor.ask(KEYS.rollout(0), rollout(0, "a", 7, 0, generation=2).encode()))
    assert answer.status == "accepted"
    assert actor.ask(KEYS.environment(0), b"") == b""


def test_what_the_log_has_already_is_not_logged_again(learners: Callable[..., Learner], actors: Any) -> None:
    """A run that was killed before a checkpoint was complete asks again for what had come."""
    learner = learners(logged_environments={(4, 0, 0)})
    learner.hub.publish(snapshot(4), hand_in=True)
    actor = actors()
    actor.join("a")
    actor.join("b")
    for given in (environment(0, "a"), environment(1, "b")):
        assert push(actor, given).status == "accepted"
    assert [Environment.decode(data).slot for data in logged(learner)] == [1]
    kept = learner.hub.environments.kept()
    assert kept is not None
    assert sorted(kept.states) == [0, 1]


def test_when_the_log_has_failed_nothing_is_kept(
    learner: Learner, actor: Actor, caplog: pytest.LogCaptureFixture
) -> None:
    """Who hands in is told to wait: it is the learner's loop that ends the run. No handler fails."""
    learner.writer.close()
    assert push(actor, environment(0, "a")) == PushReply.busy(
        "log_failed", "the log cannot be written any more: the run stops"
    )
    kept = learner.hub.environments.kept()
    assert kept is not None
    assert kept.states == {}
    assert not caplog.records
