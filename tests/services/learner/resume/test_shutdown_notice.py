"""A run that is over, whose learner was killed before its actors had heard of it."""

from __future__ import annotations

import shutil
import threading
import time
from pathlib import Path
from queue import Queue

import pytest
from samples import question

from common.config.settings import TransportSettings
from common.errors import SessionError, SettingsError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.wire.endpoint import free_port
from common.wire.keys import JOIN, Keys
from common.wire.messages import JoinReply, Orders
from common.wire.session import Session, open_session
from services.learner.resume import shutdown_notice
from services.learner.resume.shutdown_notice import send_shutdown_notice

DEADLINE_S = 15.0


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """Its log has no end, as a kill leaves it."""
    with LogWriter(tmp_path / "whole" / "log", metadata={"run": {"run": "run-1"}}) as log:
        log.write("/event", {"level": "info", "name": "a", "text": "b"})
        log.flush(DEADLINE_S)
        shutil.copytree(tmp_path / "whole", tmp_path / "run")
    return tmp_path / "run"


def first_answer(session: Session, run: str = "") -> JoinReply:
    """Asked again until it is served."""
    deadline = time.monotonic() + DEADLINE_S
    while True:
        try:
            return JoinReply.decode(session.ask(JOIN, question("a", run=run).encode(), DEADLINE_S))
        except SessionError:
            assert time.monotonic() < deadline


def test_actors_hear_it_and_the_log_is_closed(run_dir: Path) -> None:
    """Whoever asks, once and again; nothing that the log held is lost."""
    assert LogReader(run_dir).torn
    transport = TransportSettings(endpoint=f"tcp/127.0.0.1:{free_port()}")
    stop, said = threading.Event(), list[str]()
    notice = threading.Thread(
        target=send_shutdown_notice,
        args=(run_dir, transport),
        kwargs={"stop": stop, "say": said.append, "wait_s": DEADLINE_S},
    )
    notice.start()
    with open_session(connect=[transport.endpoint], connect_timeout_s=DEADLINE_S, max_message_size=1 << 20) as session:
        for _ in range(2):
            reply = first_answer(session)
            assert (reply.accepted, reply.finished, reply.final, reply.run) == (False, True, True, "run-1")
        assert LogReader(run_dir).torn, "the log is closed after the others have heard it, not before"
        stop.set()
        notice.join(DEADLINE_S)
    assert not LogReader(run_dir).torn
    assert [message.topic for message in LogReader(run_dir).messages()] == ["/event"]
    assert said[0] == (
        "run-1: its learner was killed before it notified its actors that the run is over; notifying them for 15 s"
    )
    assert said[1].startswith("repaired ")


def test_another_run_is_not_over(run_dir: Path) -> None:
    """Who wants to work for another run hears what he would of a learner: that he is wrong here."""
    transport = TransportSettings(endpoint=f"tcp/127.0.0.1:{free_port()}")
    stop = threading.Event()
    notice = threading.Thread(
        target=send_shutdown_notice, args=(run_dir, transport), kwargs={"stop": stop, "say": lambda _: None}
    )
    notice.start()
    with open_session(connect=[transport.endpoint], connect_timeout_s=DEADLINE_S, max_message_size=1 << 20) as session:
        reply = first_answer(session, run="another")
        stop.set()
        notice.join(DEADLINE_S)
    assert (reply.accepted, reply.finished, reply.final) == (False, False, True)
    assert reply.text == "this learner runs 'run-1', not 'another'"


def test_who_has_joined_hears_it_in_the_orders(run_dir: Path) -> None:
    """An evaluator in the middle of an episode asks for no run until that is over."""
    transport = TransportSettings(endpoint=f"tcp/127.0.0.1:{free_port()}")
    stop, heard = threading.Event(), Queue[Orders]()
    notice = threading.Thread(
        target=send_shutdown_notice, args=(run_dir, transport), kwargs={"stop": stop, "say": lambda _: None}
    )
    with open_session(connect=[transport.endpoint], max_message_size=1 << 20) as session:
        session.subscribe(Keys("run-1").policy_notify, lambda _, data: heard.put(Orders.decode(data)))
        notice.start()
        orders = heard.get(timeout=DEADLINE_S)
        stop.set()
        notice.join(DEADLINE_S)
    assert (orders.run, orders.finished, orders.collect) == ("run-1", True, {})


def test_it_waits_for_those_who_ask(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not less than its time, and then until nobody has asked for a while."""
    monkeypatch.setattr(shutdown_notice, "QUIET_S", 0.0)
    began_s = time.monotonic()
    transport = TransportSettings(endpoint=f"tcp/127.0.0.1:{free_port()}")
    send_shutdown_notice(run_dir, transport, stop=threading.Event(), say=lambda _: None, wait_s=0.7)
    assert time.monotonic() - began_s >= 0.7
    assert not LogReader(run_dir).torn


def test_it_has_the_doors_of_a_learner(run_dir: Path) -> None:
    """Nobody is answered from other machines without being asked who he is; the log stays as it is."""
    with pytest.raises(SettingsError, match="has no authentication"):
        send_shutdown_notice(run_dir, TransportSettings(endpoint="tcp/0.0.0.0:7447"), stop=threading.Event(), say=print)
    assert LogReader(run_dir).torn
