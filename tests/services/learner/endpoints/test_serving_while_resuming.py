"""A learner that resumes answers at once, says how far it is, and hands over to the hub without a gap."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from hub_sides import KEYS, Actor, HeldLog
from samples import RUN, settings, snapshot

from common.errors import SessionError
from common.log.writer import LogWriter
from common.wire.endpoint import free_port
from common.wire.keys import STATUS
from common.wire.report import RunReport
from common.wire.session import Session, open_session
from reskpn.health import learner_health, main, port_health
from services.learner.endpoints.health_port import health_port
from services.learner.endpoints.hub import Hub
from services.learner.endpoints.resuming import ResumingEndpoints
from services.worker.joining import join

DEADLINE_S = 15.0


@pytest.fixture
def actor(sessions: Callable[..., Session], until: Callable[..., None]) -> Callable[[], Actor]:
    """Makes an actor that knows what the learner serves: declarations arrive shortly after the connection."""

    def make() -> Actor:
        made = Actor(sessions())

        def reached() -> bool:
            try:
                return bool(made.join("?", run="somewhere-else").slug)
            except SessionError:
                return False

        until(reached)
        return made

    return make


def test_status_and_joins_say_how_far_it_is(sessions: Callable[..., Session], actor: Callable[[], Actor]) -> None:
    """From the first moment on; a worker that asks to join is told to ask again."""
    resuming = ResumingEndpoints(RUN, settings(), sessions(listen=True))
    asking = actor()
    reply = asking.join()
    assert (reply.accepted, reply.slug, reply.final, reply.run) == (False, "resuming", False, RUN)
    assert reply.text == "the learner is resuming, repairing the log; ask again later"
    resuming.read(3_000_000, 115_000_000_000)
    report = RunReport.decode(asking.ask(STATUS, b""))
    assert report.progress is not None
    assert (report.run, report.progress.phase) == (RUN, "resuming")
    assert report.waiting_for == "resuming, 3 of 115,000 MB of the log read"
    resuming.restoring()
    assert asking.join().text.startswith("the learner is resuming, the log is read")


def test_the_hub_takes_over(sessions: Callable[..., Session], actor: Callable[[], Actor], tmp_path: Any) -> None:
    """In the same declarations, so that no request finds nobody; then joins are granted."""
    session = sessions(listen=True)
    resuming = ResumingEndpoints(RUN, settings(), session)
    asking = actor()
    assert asking.join().slug == "resuming"
    with LogWriter(tmp_path) as log:
        held: Any = HeldLog(log)
        hub = Hub(RUN, settings(), session, held, lambda *event: None, serve=resuming.hand_over)
        hub.publish(snapshot(0))
        hub.open()
        assert asking.join("a" * 32).accepted
        assert RunReport.decode(asking.ask(STATUS, b"")).actors[0].slot == 0
        assert asking.ask(KEYS.policy_latest, b"")
        session.close()


def test_an_actor_waits(sessions: Callable[..., Session]) -> None:
    """With the reason, in a state of its own, and without an end of its patience; then it is let in or stopped."""
    ResumingEndpoints(RUN, settings(), sessions(listen=True))
    stop, told, states = threading.Event(), [], set()

    def asked(state: str) -> None:
        states.add(state)
        if told:
            stop.set()

    found = join(
        sessions(), run="", physics="native", versions={}, hardware={}, stop=stop, waiting=told.append, asked=asked
    )
    assert found is None
    assert told[-1] == "the learner is resuming, repairing the log; ask again later"
    assert states <= {"alone", "learner resumes"}
    assert "learner resumes" in states


def test_health_tells_ready_from_alive(capsys: pytest.CaptureFixture[str]) -> None:
    """At the listener and at the port: well, but not ready."""
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    with open_session(listen=[endpoint], max_message_size=1 << 20) as session, health_port(port) as readiness:
        resuming = ResumingEndpoints(RUN, settings(), session)
        readiness.resume(lambda: resuming.text)
        assert learner_health(endpoint, DEADLINE_S).good
        assert not learner_health(endpoint, DEADLINE_S, ready=True).good
        found = port_health(port, DEADLINE_S)
        assert (found.good, found.text) == (True, "the learner is resuming, repairing the log")
        assert main(["learner", "--port", str(port)]) == 0
        assert main(["learner", "--port", str(port), "--ready"]) == 1
        readiness.serve(RUN, lambda: True)
        assert main(["learner", "--port", str(port), "--ready"]) == 0
    assert capsys.readouterr().out.endswith(f"the learner answers joins for run {RUN}\n")
