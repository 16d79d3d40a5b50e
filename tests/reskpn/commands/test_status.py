"""`reskpn status`: one answer, again and again, or a sentence why there is none."""

from __future__ import annotations

import json
import os
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
from common.wire.status_request import ask, connect
from reskpn.cli import main
from reskpn.commands import status as status_module
from reskpn.commands.status import endpoint_of, status, status_of_run

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


# -- runs of a folder --------------------------------------------------------------------------------------


def put_run(folder: Path, endpoint: str, *, complete: bool = False) -> Path:
    """A run directory with what `status` reads of it."""
    folder.mkdir(parents=True)
    settings = {"task": "hopper", "learner": "ppo", "seed": 3, "transport": {"endpoint": endpoint}}
    (folder / "settings.json").write_text(json.dumps(settings))
    if complete:
        put_summary(folder)
    return folder


def put_summary(folder: Path) -> None:
    summary = {
        "run": "hopper-ppo-s3-ab12", "task": "hopper", "learner": "ppo", "seed": 3, "total_steps": 20480, "updates": 4,
        "wall_s": 61.0, "env_steps_per_s": 512.0, "train_return_mean": 11.25, "eval_return_mean": 12.5,
        "eval_return_std": 0.5, "eval_episodes": 64, "state_digest": "d1", "complete": True,
    }  # fmt: skip
    (folder / "summary.json").write_text(json.dumps(summary))


def test_without_an_address_the_newest_run_is_asked(
    tmp_path: Path, learner: Session, endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`train` has chosen its port by itself: the run of this folder has it."""
    monkeypatch.chdir(tmp_path)
    put_run(tmp_path / "runs" / "old", "tcp/127.0.0.1:9")
    os.utime(tmp_path / "runs" / "old" / "settings.json", (1000, 1000))
    put_run(tmp_path / "runs" / "new", endpoint)
    assert main(["status", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["run"] == "hopper-ppo-s0-ab12"


def test_an_address_of_the_environment_takes_precedence_over_runs(
    tmp_path: Path, learner: Session, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was chosen by the user; the newest run is a guess."""
    monkeypatch.chdir(tmp_path)
    put_run(tmp_path / "runs" / "new", "tcp/127.0.0.1:9")
    monkeypatch.setenv("RESKPN_TRANSPORT__ENDPOINT", endpoint)
    assert main(["status"]) == 0


def test_a_finished_run_shows_its_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And says so; nobody is asked. For machines it is the summary itself."""
    run = put_run(tmp_path / "run", "tcp/127.0.0.1:9", complete=True)
    assert main(["status", "--run-dir", str(run)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"hopper-ppo-s3-ab12: ppo on hopper has finished; {run}",
        "20,480 steps in 4 updates, seed 3, 61 s, 512 steps/s",
        "final evaluation: return 12.5 ± 0.5 over 64 episodes",
        "return while training: 11.2",
        "state digest d1",
    ]
    assert main(["status", "--run-dir", str(run), "--json", "--watch"]) == 0
    assert json.loads(capsys.readouterr().out)["state_digest"] == "d1"


def test_a_run_that_is_not_running(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No firewall is suspected: the sentence says how to continue it."""
    monkeypatch.setattr(status_module, "CONNECT_S", 0.2)
    run = put_run(tmp_path / "run", f"tcp/127.0.0.1:{free_port()}")
    assert main(["status", "--run-dir", str(run)]) == 3
    assert capsys.readouterr().err == (
        f"reskpn status: {run} is not finished and not running; continue it with: reskpn train --resume {run}\n"
    )


def test_no_run_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The default address was asked, and there are two ways to give another."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(status_module, "_endpoint_in", lambda run_dir: f"tcp/127.0.0.1:{free_port()}")
    monkeypatch.setattr(status_module, "CONNECT_S", 0.2)
    assert main(["status"]) == 3
    assert capsys.readouterr().err.endswith("There is no run in runs/ here; give --endpoint or --run-dir.\n")


def test_watching_waits_for_a_learner_and_follows_it_to_another_port(
    tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The run directory has the address of the learner before; it is read again until one answers.

    Here the learner comes with the second look, and ends the run with its second answer.
    """
    monkeypatch.setattr(status_module, "CONNECT_S", 0.2)
    monkeypatch.setattr(status_module, "WATCH_S", 0.01)
    run = put_run(tmp_path / "run", f"tcp/127.0.0.1:{free_port()}")
    said: list[str] = []

    with open_session(listen=[endpoint], max_message_size=1 << 20) as learner:
        asked = []

        def answer(request: Request) -> None:
            asked.append(request)
            request.reply(report().encode())
            if len(asked) == 2:
                put_summary(run)
                learner.close()

        learner.serve(STATUS, answer)

        def say(text: str) -> None:
            said.append(text)
            settings = json.loads((run / "settings.json").read_text())
            settings["transport"]["endpoint"] = endpoint
            (run / "settings.json").write_text(json.dumps(settings))

        assert status_of_run(run, as_json=True, watch=True, stop=STOP, say=say) == 0
    assert said == [f"waiting for the learner of {run}; Ctrl-C ends this"]
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["state_digest"] == "d1"
