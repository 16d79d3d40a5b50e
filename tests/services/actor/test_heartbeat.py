"""The actor's heartbeat: at once, twice a second, and when it is ready."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, Queue
from types import SimpleNamespace
from typing import Any

import pytest
from samples import RUN, settings

from common.errors import SessionError
from common.wire.messages import Heartbeat
from services.actor import heartbeat
from services.actor.heartbeat import NO_POLICY, HeartbeatSender
from services.worker.joining import Assignment

DEADLINE_S = 15.0
MEMBER = Assignment(RUN, 3, 1, "a", settings())


class Beats:
    """A link that keeps what is beaten; once `closed` it is a session that is closed."""

    def __init__(self) -> None:
        self.heard: Queue[Heartbeat] = Queue()
        self.closed = False

    def send_heartbeat(self, beat: Heartbeat) -> None:
        if self.closed:
            raise SessionError("this session is closed")
        self.heard.put(beat)

    def next(self) -> Heartbeat:
        return self.heard.get(timeout=DEADLINE_S)


@pytest.fixture
def beats() -> Beats:
    return Beats()


@pytest.fixture
def heart(beats: Beats) -> HeartbeatSender:
    link: Any = beats
    return HeartbeatSender(link, MEMBER)


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next regular heartbeat is an hour away."""
    monkeypatch.setattr(heartbeat, "PERIOD_S", 3600.0)


def test_the_first_is_sent_at_once(heart: HeartbeatSender, beats: Beats, still: None) -> None:
    """It says who the actor is, and that it compiles."""
    with heart:
        beat = beats.next()
    assert (beat.run, beat.slot, beat.incarnation, beat.state) == (RUN, 3, "a", "compiling")
    assert (beat.version, beat.env_steps, beat.steps_per_s) == (0, 0, 0.0)


def test_they_go_on(heart: HeartbeatSender, beats: Beats, monkeypatch: pytest.MonkeyPatch) -> None:
    """By themselves, with what the actor does at that time."""
    monkeypatch.setattr(heartbeat, "PERIOD_S", 0.01)
    with heart:
        heart.set_state("waiting")
        heart.version = 7
        heart.set_state("collecting")
        while (beat := beats.next()).state != "collecting":
            assert beat.state in ("compiling", "waiting")
        assert beat.version == 7
        assert beats.next().state == "collecting"


def test_being_ready_is_told_at_once(heart: HeartbeatSender, beats: Beats, still: None) -> None:
    """Work depends on it; other changes wait for the next heartbeat."""
    with heart:
        assert beats.next().state == "compiling"
        heart.set_state("waiting")
        assert beats.heard.get_nowait().state == "waiting"
        heart.set_state("collecting")
        with pytest.raises(Empty):
            beats.heard.get_nowait()


def test_what_is_beaten_is_also_kept(beats: Beats, still: None) -> None:
    """For checks on the actor's own machine, where no policy is told from policy 0."""
    kept: list[tuple[str, int]] = []
    link: Any = beats
    with HeartbeatSender(link, MEMBER, lambda state, version: kept.append((state, version))) as heart:
        assert beats.next().version == 0
        heart.version = 0
        heart.set_state("waiting")
        assert beats.next().version == 0
    assert kept == [("compiling", NO_POLICY), ("waiting", 0)]


def test_none_is_sent_after_the_end(heart: HeartbeatSender, beats: Beats, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaving waits for the thread, not for the period."""
    with heart:
        beats.next()
    assert "heartbeat" not in {thread.name for thread in threading.enumerate()}
    assert beats.heard.empty()


def test_a_closed_session_ends_them(
    heart: HeartbeatSender, beats: Beats, monkeypatch: pytest.MonkeyPatch, until: Callable[..., None]
) -> None:
    """Without a word: the actor's own thread finds out, too."""
    monkeypatch.setattr(heartbeat, "PERIOD_S", 0.01)
    with heart:
        beats.next()
        beats.closed = True
        until(lambda: "heartbeat" not in {thread.name for thread in threading.enumerate()})


def test_times_and_speed(heart: HeartbeatSender, beats: Beats, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds in the state, all steps taken, and the speed since the first steps were there."""
    clock = SimpleNamespace(now=50.0)
    monkeypatch.setattr(heartbeat, "time", SimpleNamespace(monotonic=lambda: clock.now, time_ns=lambda: 99))
    monkeypatch.setattr(heartbeat, "PERIOD_S", 0.001)

    def beat_at(now: float, env_steps: int = 0) -> Heartbeat:
        clock.now = now
        if env_steps:
            heart.stepped(env_steps)
        while not beats.heard.empty():
            beats.next()
        beats.next()  # may have been made before the clock was moved
        return beats.next()

    with heart:
        heart.set_state("waiting")
        assert beat_at(53.0).state_s == 3.0
        # The first steps: nobody knows how long they took.
        first = beat_at(53.0, env_steps=1000)
        assert (first.env_steps, first.steps_per_s, first.t_ns) == (1000, 0.0, 99)
        # 600 steps in the 2 s since the first were there.
        second = beat_at(55.0, env_steps=600)
        assert (second.env_steps, second.steps_per_s) == (1600, 300.0)
