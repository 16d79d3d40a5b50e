"""`reskpn dashboard`: what it refuses, with a sentence each, and how it starts."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from dashboard_runs import write_run

from common.errors import SessionError, SettingsError
from common.wire import listening_socket
from common.wire.endpoint import free_port
from common.wire.listening_socket import address_of, listen
from reskpn.cli import main
from services.dashboard.service import check_token

TOKEN = "a-token-of-some-length"


def refused(*words: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["dashboard", *words]) in (2, 3)
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_no_such_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused("--run-dir", str(tmp_path / "none"), capsys=capsys)
    assert line.startswith(f"reskpn dashboard: --run-dir {tmp_path / 'none'}: there is no such directory")


def test_no_runs_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Without options it is for runs/ of this folder."""
    monkeypatch.chdir(tmp_path)
    assert "there is no folder runs/ here" in refused(capsys=capsys)


def test_no_learner_at_the_address(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert f"no connection to {endpoint} within 3 s" in refused("--endpoint", endpoint, capsys=capsys)
    assert "is not an address" in refused("--endpoint", "learner:7447", capsys=capsys)


def test_a_port_in_use(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A port that was asked for is not replaced by another."""
    write_run(tmp_path / "run")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        line = refused("--run-dir", str(tmp_path / "run"), "--port", port, capsys=capsys)
    assert f"port {port} of 127.0.0.1 is in use; give another with --port" in line


def test_the_default_port_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next that is free is taken; where all are in use that is said."""
    with listen("127.0.0.1", free_port()) as first:
        monkeypatch.setattr(listening_socket, "PORT", first.getsockname()[1])
        with listen("127.0.0.1", None) as second:
            assert first.getsockname()[1] < second.getsockname()[1] < first.getsockname()[1] + listening_socket.TRIED
        monkeypatch.setattr(listening_socket, "TRIED", 1)
        with pytest.raises(SessionError, match="are all in use; give another with --port"):
            listen("127.0.0.1", None)


def test_a_host_that_is_not_of_this_machine(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    write_run(tmp_path / "run")
    line = refused("--run-dir", str(tmp_path / "run"), "--host", "192.0.2.1", "--new-token", capsys=capsys)
    assert "cannot serve the page on 192.0.2.1:" in line


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1"])
def test_other_machines_need_a_token(host: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is refused before anything is opened."""
    line = refused("--run-dir", str(tmp_path), "--host", host, capsys=capsys)
    assert line.startswith(f"reskpn dashboard: --host {host} lets other machines read the page: give a token")
    check_token(host, TOKEN)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1"])
def test_this_machine_needs_none(host: str) -> None:
    check_token(host, None)
    with pytest.raises(SettingsError, match="the token has 5 characters, and could be guessed"):
        check_token(host, "short")


@pytest.mark.parametrize(
    ("content", "reason"), [(None, "No such file"), (b"", "is empty"), (b"\xff\xfe", "is not text")]
)
def test_a_token_file_that_has_none(
    content: bytes | None, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "token"
    if content is not None:
        path.write_bytes(content)
    assert reason in refused("--run-dir", str(tmp_path), "--token-file", str(path), capsys=capsys)


def test_addresses_to_open() -> None:
    """One that a browser of this machine understands, with the token."""
    with listen("127.0.0.1", free_port()) as one:
        assert address_of(one) == f"http://127.0.0.1:{one.getsockname()[1]}/"
        assert address_of(one, "t").endswith("/?token=t")
    with listen("0.0.0.0", free_port()) as every:
        assert address_of(every).startswith("http://127.0.0.1:")


def test_it_starts_without_jax_and_stops_with_its_supervisor(tmp_path: Path) -> None:
    """As `train` starts it, on a socket that it inherits. JAX and MuJoCo, which take seconds, are not loaded."""
    write_run(tmp_path / "run")
    program = (
        "import sys; from reskpn.cli import main; code = main(sys.argv[1:]);"
        "print(sorted({'jax', 'flax', 'brax', 'mujoco', 'scipy', 'matplotlib', 'pyarrow'} & set(sys.modules)));"
        "sys.exit(code)"
    )
    pipe = subprocess.PIPE
    with listen("127.0.0.1", free_port()) as listening:
        fd, address = listening.fileno(), address_of(listening)
        words = ["dashboard", "--supervised", "--run-dir", str(tmp_path / "run"), "--listening", str(fd)]
        command = [sys.executable, "-c", program, *words]
        process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, pass_fds=[fd], env=os.environ)
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert f"live page of {tmp_path / 'run'}: {address}" in process.stdout.readline()
        with urllib.request.urlopen(f"{address}stream", timeout=20.0) as stream:
            lines = [stream.readline() for _ in range(2)]
        assert json.loads(lines[1].removeprefix(b"data: "))["shown"] == ["run"]
        process.stdin.close()
        assert process.stdout.read().strip() == "[]"
    assert process.returncode == 0
