"""The doctor as a whole."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from common.wire.endpoint import free_port
from reskpn.cli import main
from reskpn.doctor import examine
from reskpn.doctor.findings import Finding

CHECKS = [
    "python",
    "packages",
    "jax",
    "cores",
    "memory",
    "disk",
    "writing",
    "port",
    "clock",
    "zenoh",
    "native",
    "mjx",
]  # in the order in which a run would meet them


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("RESKPN_")]:
        monkeypatch.delenv(name)


def doctor(tmp_path: Path, *words: str) -> int:
    small = ["--num-envs", "8", "--algorithm.hidden", "[8, 8]", "--run-dir", str(tmp_path / "run")]
    return main(["doctor", *small, "--algorithm.minibatches", "4", *words])


def test_a_line_for_each_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On a machine that has all it takes: exit code 0, and no file is left behind."""
    assert doctor(tmp_path, "--transport.endpoint", f"tcp/127.0.0.1:{free_port()}") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == CHECKS
    assert {line.split()[0] for line in lines} <= {"ok", "warning"}
    assert list(tmp_path.iterdir()) == []


def test_a_problem_is_an_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other checks are made all the same; for machines it is one JSON object."""
    monkeypatch.setattr(examine, "check_jax", lambda: Finding("jax", "problem", "no devices", "look at the driver"))
    for name in ("check_native", "check_zenoh"):
        monkeypatch.setattr(examine, name, lambda: Finding("other", "ok", "not made here"))
    (tmp_path / "run").write_text("a file where the directory should be")
    assert doctor(tmp_path, "--transport.endpoint", f"tcp/127.0.0.1:{free_port()}", "--json") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["problems"] == 3  # jax, disk, writing
    assert len(found["findings"]) == len(CHECKS)
    assert found["findings"][2] == {
        "name": "jax",
        "level": "problem",
        "text": "no devices",
        "advice": "look at the driver",
        "figures": {},
    }


def test_an_actor_without_a_learner(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """--endpoint is where an actor will look for its learner: nobody there is a problem, and an exit code."""
    monkeypatch.setattr(examine, "state_sizes", lambda settings: (0, 0))
    for name in ("check_native", "check_zenoh"):
        monkeypatch.setattr(examine, name, lambda: Finding("other", "ok", "not made here"))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert doctor(tmp_path, "--endpoint", endpoint) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if " port " in line]
    assert line == (
        f"problem  port       nobody listens at {endpoint}, where a learner should be; "
        "start the learner first, or check its address"
    )


def test_what_is_no_address(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A problem of the port, with an example of one."""
    monkeypatch.setattr(examine, "state_sizes", lambda settings: (0, 0))
    for name in ("check_native", "check_zenoh"):
        monkeypatch.setattr(examine, name, lambda: Finding("other", "ok", "not made here"))
    assert doctor(tmp_path, "--endpoint", "here") == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if " port " in line]
    assert line.startswith("problem  port       'here' is not an address")
