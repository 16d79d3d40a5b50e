"""`python -m reskpn.health`: the learner answers joins, the actor has a policy."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from common.wire.endpoint import free_port
from common.wire.keys import JOIN
from common.wire.messages import Join, JoinReply
from common.wire.session import Request, open_session
from reskpn.health import main


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


def ask_learner(endpoint: str, timeout_s: float = 15.0) -> int:
    return main(["learner", "--endpoint", endpoint, "--timeout", str(timeout_s)])


def test_a_learner_that_answers_joins(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Is well. It was asked for a run that it cannot have, so nobody has joined."""
    asked: list[Join] = []

    def answer(request: Request) -> None:
        asked.append(Join.decode(request.payload))
        request.reply(JoinReply.refused("r", "run", "this learner runs 'r'", final=True).encode())

    with open_session(listen=[endpoint], max_message_size=1 << 20) as session:
        session.serve(JOIN, answer)
        assert ask_learner(endpoint) == 0
    assert capsys.readouterr().out == "the learner answers joins for run r\n"
    assert [join.run for join in asked] == ["health-check"]


def test_no_learner(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Is not well, within the time."""
    assert ask_learner(endpoint, 0.2) == 1
    assert f"takes no joins: no connection to {endpoint} within 0.2 s" in capsys.readouterr().out


@pytest.mark.parametrize("serves", [False, True])
def test_a_learner_that_does_not_answer(endpoint: str, capsys: pytest.CaptureFixture[str], serves: bool) -> None:
    """It listens, but serves no joins yet, or hangs."""
    kept: list[Request] = []
    with open_session(listen=[endpoint], max_message_size=1 << 20) as session:
        if serves:
            session.serve(JOIN, kept.append)
        assert ask_learner(endpoint, 0.5) == 1
    assert "the learner takes no joins: no answer on reskpn/v1/join" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("state", "version", "age_s", "code", "text"),
    [
        ("collecting", 0, 0.0, 0, "the actor has policy 0 (collecting)"),
        ("waiting", 12, 14.0, 0, "the actor has policy 12 (waiting)"),
        ("standing by", -1, 0.0, 0, "the actor stands by: all slots are taken"),
        ("compiling", -1, 0.0, 1, "the actor has no policy yet (compiling)"),
        ("alone", -1, 0.0, 1, "the actor has no policy yet (alone)"),
        ("collecting", 12, 40.0, 1, "the actor last reported 40 s ago (collecting)"),
        ("standing by", -1, 40.0, 1, "the actor last reported 40 s ago (standing by)"),
    ],
)
def test_actors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], state: str, version: int, age_s: float, code: int, text: str
) -> None:
    """Well with a policy or standing by, if that was said within 15 s."""
    file = tmp_path / "actor.json"
    file.write_text(json.dumps({"state": state, "version": version, "time_s": time.time() - age_s}))
    assert main(["actor", "--state-file", str(file)]) == code
    assert capsys.readouterr().out == f"{text}\n"


def test_evaluators(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As actors."""
    file = tmp_path / "evaluator.json"
    file.write_text(json.dumps({"state": "evaluating", "version": 12, "time_s": time.time()}))
    assert main(["evaluator", "--state-file", str(file)]) == 0
    assert capsys.readouterr().out == "the evaluator has policy 12 (evaluating)\n"


def test_an_actor_that_has_not_begun(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Has no file."""
    assert main(["actor", "--state-file", str(tmp_path / "actor.json")]) == 1
    assert capsys.readouterr().out.startswith("no actor has written ")


def test_a_file_that_is_no_actors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2, as for any setting that is not possible."""
    file = tmp_path / "other.json"
    file.write_text("hello")
    assert main(["actor", "--state-file", str(file)]) == 2
    assert "is not one that an actor keeps" in capsys.readouterr().err


def test_a_router_that_lets_in_is_well(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a learner behind it, too; where nothing listens it is not well."""
    with open_session(listen=[endpoint], max_message_size=1 << 20, options={"mode": "router"}):
        assert main(["router", "--endpoint", endpoint, "--timeout", "15"]) == 0
    assert capsys.readouterr().out == f"the router at {endpoint} accepts connections\n"
    assert main(["router", "--endpoint", endpoint, "--timeout", "0.2"]) == 1
    assert f"accepts no connection: no connection to {endpoint} within 0.2 s" in capsys.readouterr().out
