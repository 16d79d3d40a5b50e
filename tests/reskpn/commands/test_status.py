"""`reskpn status`: one answer, again and again, or a sentence why there is none."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from reports import report

from common.errors import CodecError, SessionError, SettingsError
from common.wire.endpoint import free_port
from common.wire.keys import STATUS
from common.wire.session import Request, Session, open_session
from reskpn.cli import main
from reskpn.commands import status as status_module
from reskpn.commands.status import ask, connect, endpoint_of, status

STOP = threading.Event()  # never set


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def learner(endpoint: str) -> Iterator[Session]:
    """Answers with a report."""
    with open_session(listen=[endpoint], max_message_size=1 << 20) as session:
        session.serve(STATUS, lambda request: request.reply(report().encode()))
        yield session


def test_one_report(learner: Session, endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The run's lines, and a row for each actor; lines are whole where no terminal breaks them."""
    assert main(["status", "--endpoint", endpoint]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "hopper-ppo-s0-ab12: ppo on hopper at tcp/127.0.0.1:7447, up 61 s"
    assert [line.split()[:3] for line in lines[4:6]] == [["0", "5f31aa00", "host-1"], ["1", "5f31aa00", "host-1"]]


def test_one_report_for_machines(learner: Session, endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One line of JSON with everything in it."""
    assert main(["status", "--endpoint", endpoint, "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line) == report().model_dump(mode="json")


@pytest.mark.parametrize("as_json", [False, True])
def test_watching_goes_on_until_it_is_stopped(
    endpoint: str, as_json: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Asked again and again; being stopped, here with the third answer, is no failure."""
    monkeypatch.setattr(status_module, "WATCH_S", 0.01)
    stop, asked = threading.Event(), []

    def answer(request: Request) -> None:
        asked.append(request)
        if len(asked) == 3:
            stop.set()
        request.reply(report().encode())

    with open_session(listen=[endpoint], max_message_size=1 << 20) as learner:
        learner.serve(STATUS, answer)
        assert status(endpoint, as_json=as_json, watch=True, stop=stop) == 0
    out = capsys.readouterr().out
    assert len(asked) == 3
    assert out.count("hopper-ppo-s0-ab12") == 2
    assert len(out.splitlines()) == (2 if as_json else 14)


def test_a_learner_that_goes_away_while_it_is_watched(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ends with a sentence."""
    monkeypatch.setattr(status_module, "WATCH_S", 0.01)
    monkeypatch.setattr(status_module, "CONNECT_S", 0.5)
    session = open_session(listen=[endpoint], max_message_size=1 << 20)
    session.serve(STATUS, lambda request: request.reply(report().encode()))
    calls = []
    printed = status_module._print

    def leaving(*words: object, **more: bool) -> None:
        calls.append(1)
        printed(*words, **more)  # type: ignore[arg-type]
        if len(calls) == 2:
            session.close()

    monkeypatch.setattr(status_module, "_print", leaving)
    with pytest.raises(SessionError, match=r"the learner of hopper-ppo-s0-ab12 does not answer any more"):
        status(endpoint, as_json=True, watch=True, stop=STOP)


def test_no_learner_there(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A sentence and exit code 3, within a few seconds."""
    began_s = time.monotonic()
    assert main(["status", "--endpoint", endpoint]) == 3
    assert time.monotonic() - began_s < 8.0
    err = capsys.readouterr().err
    assert err.startswith(
        f"reskpn status: no connection to {endpoint} within 3 s. Likely causes: no learner is running"
    )
    assert len(err.splitlines()) == 1


def test_another_program_has_the_port(capsys: pytest.CaptureFixture[str]) -> None:
    """One that takes connections and says nothing: found out as soon."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        began_s = time.monotonic()
        with pytest.raises(SessionError, match=f"no connection to {endpoint} within 0.5 s"):
            connect(endpoint, 0.5)
        assert time.monotonic() - began_s < 5.0


def test_something_else_of_zenoh_is_there(endpoint: str) -> None:
    """A learner that still starts looks the same: it does not answer yet."""
    with (
        open_session(listen=[endpoint], max_message_size=1 << 20),
        connect(endpoint) as session,
        pytest.raises(SessionError, match=f"something listens at {endpoint} but does not answer as a learner"),
    ):
        ask(session, endpoint, 0.3)


def test_an_answer_that_is_no_report(endpoint: str) -> None:
    """Is not shown."""
    with open_session(listen=[endpoint], max_message_size=1 << 20) as other:
        other.serve(STATUS, lambda request: request.reply(b'{"run": 1}'))
        with connect(endpoint) as session, pytest.raises(CodecError, match="this is not the report of a learner"):
            ask(session, endpoint)


def test_the_address_out_of_a_run_directory(tmp_path: Path, learner: Session, endpoint: str) -> None:
    """`train` chooses a free port, and the run's settings have it."""
    (tmp_path / "settings.json").write_text(json.dumps({"transport": {"endpoint": endpoint}}))
    assert endpoint_of(tmp_path) == endpoint
    assert main(["status", "--run-dir", str(tmp_path), "--json"]) == 0


@pytest.mark.parametrize("content", [None, "{", "[]", "{}", '{"transport": 1}'])
def test_a_directory_without_a_run(tmp_path: Path, content: str | None) -> None:
    """Says which one, and that a run's is wanted."""
    if content is not None:
        (tmp_path / "settings.json").write_text(content)
    with pytest.raises(SettingsError, match=f"--run-dir {tmp_path}: settings.json .* of a run"):
        endpoint_of(tmp_path)
