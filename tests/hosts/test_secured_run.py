"""A whole run behind certificates and access control, as processes on loopback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from common.errors import SessionError, WireError
from common.log.reader import LogReader
from common.wire.credentials import Credentials
from common.wire.endpoint import free_port
from common.wire.report import RunReport
from common.wire.status_request import ask, connect
from reskpn.authority import make_all
from tests.integration.small_runs import BATCH, SMALL, TICK, small_run

UPDATES = 4
DEADLINE_S = 120.0


@contextmanager
def service(*words: str) -> Iterator[subprocess.Popen[str]]:
    """`reskpn` with those words; it does not outlive the test."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RESKPN_")}
    process = subprocess.Popen(
        [sys.executable, "-m", "reskpn", *words],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def reported(endpoint: str, viewer: Credentials) -> RunReport:
    """What the learner answers to a viewer, once it does."""
    deadline = time.monotonic() + DEADLINE_S
    while True:
        try:
            with connect(endpoint, credentials=viewer) as session:
                return ask(session, endpoint)
        except WireError:
            assert time.monotonic() < deadline
            TICK.wait(0.1)


@pytest.mark.timeout(400)
def test_a_secured_run_ends_as_one_without(tmp_path: Path) -> None:
    """In the same state. Meanwhile an outsider hears why it is not let in, and the learner counts and logs it."""
    with small_run(tmp_path / "open", updates=UPDATES) as plain:
        code, output = plain.finish()
        assert code == 0, output
        digest = plain.summary["state_digest"]
    make_all(tmp_path / "ours", ["127.0.0.1"], days=1)
    make_all(tmp_path / "theirs", ["127.0.0.1"], days=1)
    endpoint, run_dir = f"tls/127.0.0.1:{free_port()}", tmp_path / "secured"
    settings = [*SMALL, "--total-steps", str(BATCH * UPDATES), "--evaluation.episodes", "32"]
    own = ["--transport.endpoint", endpoint, "--transport.certificates", str(tmp_path / "ours" / "learner")]
    with ExitStack() as stack:
        learner = stack.enter_context(service("learner", "--run-dir", str(run_dir), *own, *settings))
        viewer = Credentials(tmp_path / "ours" / "viewer")
        assert reported(endpoint, viewer).actors == []
        with pytest.raises(SessionError, match="the certificate that the learner shows was not accepted here"):
            connect(endpoint, 1.0, Credentials(tmp_path / "theirs" / "actor"))
        assert set(reported(endpoint, viewer).refusals["connection"]) == {"untrusted"}
        mine = ["--certificates", str(tmp_path / "ours" / "actor"), "--threads", "1"]
        actors = [stack.enter_context(service("actor", "--endpoint", endpoint, *mine)) for _ in range(2)]
        output, _ = learner.communicate(timeout=DEADLINE_S)
        assert learner.returncode == 0, output
        assert [actor.wait(DEADLINE_S) for actor in actors] == [0, 0]
    assert json.loads((run_dir / "summary.json").read_text())["state_digest"] == digest
    events = [message.json() for message in LogReader(run_dir).messages(["/event"])]
    assert [event["level"] for event in events if event["name"] == "connection_refused"] == ["warning"]
    assert "zenoh" not in output
