"""Joining a run, with a learner that answers what the test has prepared."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest
from learner_script import Script, ask_to_join, reply
from samples import RUN, settings

from common.errors import RefusedError, SessionError
from common.wire import codec
from common.wire.keys import JOIN
from common.wire.messages import Join
from common.wire.session import Session
from services.worker.joining import Assignment, join

DEADLINE_S = 15.0

Sessions = Callable[..., Session]


@pytest.fixture
def stop() -> threading.Event:
    return threading.Event()


def test_joining_gives_a_place_and_the_settings(sessions: Sessions, stop: threading.Event) -> None:
    """What the learner answered, under the name that was asked with."""
    learner, script = sessions(listen=True), Script(reply(True))
    learner.serve(JOIN, script)
    member = ask_to_join(sessions(), stop)
    asked = Join.decode(script.asked[0])
    assert member == Assignment(RUN, 1, 2, asked.incarnation, settings(seed=7))
    assert (asked.run, asked.role, asked.physics) == (RUN, "actor", "native")


def test_joining_goes_on_until_there_is_a_learner(
    sessions: Sessions, stop: threading.Event, until: Callable[..., None]
) -> None:
    """An actor may be started first; it says once why it waits."""
    told: list[str] = []
    session = sessions(connect_timeout_s=None)
    with ThreadPoolExecutor(1) as pool:
        joined = pool.submit(ask_to_join, session, stop, told)
        until(lambda: bool(told))
        learner = sessions(listen=True)
        learner.serve(JOIN, Script(reply(True)))
        member = joined.result(DEADLINE_S)
    assert member is not None
    assert member.slot == 1
    assert told == ["no learner answers yet"]


def test_a_peer_that_answers_nothing_is_waited_for_as_long_as_was_said(
    sessions: Sessions, stop: threading.Event
) -> None:
    """Connected is not answered: what listens there may be no learner. The error says so, and joining ends."""
    sessions(listen=True)
    with pytest.raises(SessionError, match=r"no learner answered within 0\.5 s: .* is connected, but serves nothing"):
        join(sessions(), run="", physics="native", versions={}, hardware={}, stop=stop, waiting=str, timeout_s=0.5)


def test_a_refusal_is_an_answer(sessions: Sessions, stop: threading.Event) -> None:
    """Standing by for longer than the timeout is no silence: the time starts again with every answer."""
    learner = sessions(listen=True)
    learner.serve(JOIN, Script(*[reply(False, "full")] * 6, reply(True)))
    # Six pauses of 0.25 s are longer than 1 s.
    member = join(
        sessions(), run=RUN, physics="native", versions={}, hardware={}, stop=stop, waiting=str, timeout_s=1.0
    )
    assert member is not None


def test_an_actor_that_stands_by_asks_again_under_new_names(sessions: Sessions, stop: threading.Event) -> None:
    """A refusal that is not final is tried again; each reason is told once, and no two lives have one name."""
    learner = sessions(listen=True)
    script = Script(reply(False, "full"), reply(False, "full"), reply(False, "still full"), reply(True))
    learner.serve(JOIN, script)
    told: list[str] = []
    member = ask_to_join(sessions(), stop, told)
    assert member is not None
    assert [reason for reason in told if reason != "no learner answers yet"] == ["full", "still full"]
    names = [Join.decode(asked).incarnation for asked in script.asked]
    assert len(set(names)) == 4
    assert member.incarnation == names[-1]


def test_a_final_refusal_ends_it(sessions: Sessions, stop: threading.Event) -> None:
    """With the learner's reason."""
    learner = sessions(listen=True)
    learner.serve(JOIN, Script(reply(False, "this learner runs 'b', not 'a'", final=True)))
    with pytest.raises(RefusedError, match="the learner does not take this actor: this learner runs 'b', not 'a'"):
        ask_to_join(sessions(), stop)


def test_a_run_that_is_over_is_no_refusal(sessions: Sessions, stop: threading.Event) -> None:
    """An actor that comes too late, or stood by to the end, has nothing to do and no reason to fail."""
    over = reply(False, "nothing is left to do", slug="finished", final=True)
    learner = sessions(listen=True)
    learner.serve(JOIN, Script(reply(False, "full"), over))
    told: list[str] = []
    assert ask_to_join(sessions(), stop, told) is None
    assert told[-2:] == ["full", "nothing is left to do"]


def test_every_question_without_a_slot_is_told(sessions: Sessions, stop: threading.Event) -> None:
    """Also those with the same reason, so that somebody can see that the actor lives."""
    learner = sessions(listen=True)
    learner.serve(JOIN, Script(reply(False, "full"), reply(False, "full"), reply(True)))
    states: list[str] = []
    member = join(
        sessions(), run=RUN, physics="native", versions={}, hardware={}, stop=stop, waiting=str, asked=states.append
    )
    assert member is not None
    assert [state for state in states if state != "alone"] == ["standing by", "standing by"]


def test_a_learner_of_another_schema(sessions: Sessions, stop: threading.Event) -> None:
    """An answer that this release cannot read ends it, too."""
    learner = sessions(listen=True)
    other = codec.encode(codec.decode(reply(True)) | {"schema": 999})
    learner.serve(JOIN, Script(other))
    with pytest.raises(RefusedError, match=r"speaks another protocol: JoinReply of schema 999.* run the same release"):
        ask_to_join(sessions(), stop)


def test_joining_can_be_stopped(sessions: Sessions, stop: threading.Event) -> None:
    """None, where `stop` comes before a slot."""
    session = sessions(connect_timeout_s=None)
    told: list[str] = []

    def once_told(reason: str) -> None:
        told.append(reason)
        stop.set()

    found = join(session, run="", physics="native", versions={}, hardware={}, stop=stop, waiting=once_told)
    assert found is None
    assert told == ["no learner answers yet"]
