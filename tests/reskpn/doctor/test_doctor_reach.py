"""Checks of the network, with whoever may be at the port."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from reports import actor, report

from common.errors import SettingsError
from common.wire.credentials import Credentials
from common.wire.endpoint import Endpoint, free_port
from common.wire.keys import STATUS
from common.wire.session import Request, open_session
from reskpn.doctor import reach
from reskpn.doctor.reach import Answer, ask_learner, check_clock, check_port, check_zenoh, port_state


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def learner(endpoint: str) -> Iterator[None]:
    """Has one of two actors, and a clock that is an hour ahead."""

    def answer(request: Request) -> None:
        now_ns = time.time_ns() + 3600 * 10**9
        request.reply(report(t_ns=now_ns, actors=[actor(0)]).encode())

    with open_session(listen=[endpoint], max_message_size=1 << 20) as session:
        session.serve(STATUS, answer)
        yield


def test_a_free_port(endpoint: str) -> None:
    """Nobody is asked."""
    found, answer = check_port(endpoint)
    assert (found.level, answer) == ("ok", None)
    assert found.text == f"{endpoint} is free: no learner runs there, and one can be started"


def test_credentials_are_looked_at_first(endpoint: str, tmp_path: Path) -> None:
    """What a learner could not start with is a problem also while the port is free."""
    with pytest.raises(SettingsError, match=r"ca\.crt cannot be read"):
        check_port(endpoint.replace("tcp/", "tls/"), Credentials(tmp_path))


def test_a_learner_is_named(endpoint: str, learner: None) -> None:
    """With its run and its actors; its clock can be told from its answer."""
    found, answer = check_port(endpoint)
    assert (found.level, found.text) == (
        "ok",
        f"{endpoint}: the learner of hopper-ppo-s0-ab12 answers, with 1 of 2 actors",
    )
    clock = check_clock(answer)
    assert clock.level == "warning"
    # An hour, give or take half of the round trip.
    assert abs(clock.figures["ahead_s"] - 3600.0) <= clock.figures["unsure_s"]
    assert clock.text.startswith("the learner's is 3")


def test_another_program_at_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """Is a problem for who wants to start a learner there."""
    monkeypatch.setattr(reach, "CONNECT_S", 0.3)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        found, answer = check_port(endpoint)
    assert (found.level, answer) == ("problem", None)
    assert found.text == f"{endpoint} is in use by a process that does not answer as a learner of this release"


def test_a_learner_of_another_release(endpoint: str) -> None:
    """What answers is not a report."""
    with open_session(listen=[endpoint], max_message_size=1 << 20) as session:
        session.serve(STATUS, lambda request: request.reply(b"{}"))
        found, _ = check_port(endpoint)
    assert found.level == "problem"
    assert "run the same release on both sides" in found.text


@pytest.mark.parametrize(("host", "state"), [("192.0.2.1", "elsewhere"), ("no-such-host.invalid", "unknown")])
def test_hosts_that_are_not_this_one(host: str, state: str) -> None:
    """An address of another machine, and a name of none."""
    assert port_state(Endpoint("tcp", host, 7447)) == state


def test_a_clock_that_agrees() -> None:
    """To within a second and what the round trip leaves open."""
    assert check_clock(Answer(report(), -0.9, 0.05)).level == "ok"
    assert check_clock(Answer(report(), -1.04, 0.05)).level == "ok"
    behind = check_clock(Answer(report(), -1.06, 0.05))
    assert (behind.level, behind.text) == ("warning", "the learner's is 1.060 s behind this one (to within 0.050 s)")
    assert check_clock(None).level == "ok"


def test_an_answer_takes_its_time_from_the_second_question(endpoint: str, learner: None) -> None:
    """The first may wait until the learner's keys are known, which says nothing about its clock."""
    assert ask_learner(endpoint).unsure_s < 1.0


def test_zenoh_on_loopback() -> None:
    """A round trip and a rate that somebody measured."""
    found = check_zenoh(count=3, bulk_bytes=1_000_000)
    assert found.text.startswith("round trip ")
    assert found.text.endswith("in messages of 1.0 MB")
    assert 0.0 < found.figures["latency_s"] < 10.0
    assert found.figures["bytes_per_s"] > 0.0
