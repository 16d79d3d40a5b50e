"""docker-compose.yml and what belongs to it agree with the code."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from common.config.settings import RunSettings
from common.config.sources import load
from reskpn import cli
from scripts import document_environment
from scripts.document_environment import EXAMPLE, OWN, PASSED_ON, example, passed_on

ROOT = Path(__file__).parent.parent
VARIABLE = re.compile(r"\$\{(\w+):-([^}]*)\}")


@pytest.fixture
def compose() -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
    return content


def filled(value: str) -> str:
    """With the defaults of its variables."""
    return VARIABLE.sub(r"\2", value)


def test_generated_files_are_current() -> None:
    """They are those that `python -m scripts.document_environment` writes."""
    assert EXAMPLE.read_text() == example()
    assert PASSED_ON.read_text() == passed_on()


def test_every_setting_can_be_given() -> None:
    """By its variable: passed on as it is, or set by docker-compose.yml itself."""
    names = {line for line in passed_on().splitlines() if line and not line.startswith("#")}
    assert not names & OWN
    count = sum(
        len(type(field.default).model_fields) if hasattr(type(field.default), "model_fields") else 1
        for field in RunSettings.model_fields.values()
    )
    assert len(names | OWN) == count


def test_the_example_holds_the_defaults() -> None:
    """All lines taken in, they are the settings as they are without any."""
    lines = [line.removeprefix("# ") for line in example().splitlines() if re.match(r"# RESKPN_\w+=.", line)]
    given = dict(line.split("=", 1) for line in lines)
    own = {name: given.pop(name) for name in ("RESKPN_ACTORS", "RESKPN_SLOT_WAIT_S")}
    assert own == {"RESKPN_ACTORS": "4", "RESKPN_SLOT_WAIT_S": "15"}
    assert load(environment=given) == load(environment={})


def test_the_example_names_every_variable_of_the_file() -> None:
    """With the default that the file has for it."""
    text = "".join((ROOT / name).read_text() for name in ("docker-compose.yml", "docker-compose.gpu.yml"))
    used = set(VARIABLE.findall(text))
    assert len(used) > 10
    shown = {tuple(line[2:].split("=", 1)) for line in document_environment.HEAD.splitlines() if "=" in line}
    assert used <= shown


@pytest.mark.parametrize("service", ["learner", "actor", "evaluator"])
def test_what_the_file_sets_is_possible(compose: dict[str, Any], service: str) -> None:
    """The settings it gives are accepted; they leave its network closed."""
    given = {name: filled(value) for name, value in compose["services"][service]["environment"].items()}
    settings = load(environment=given)
    assert settings.actors == 4
    assert settings.slot_wait_s == 15.0
    assert set(given) == OWN
    assert compose["networks"]["default"]["internal"] is True
    assert "ports" not in compose["services"][service]


def test_tensorboard_sees_the_runs_and_nothing_else(compose: dict[str, Any]) -> None:
    """It is started when asked for, reads the volume that the learner writes, and is on no network of the others."""
    service = compose["services"]["tensorboard"]
    assert service["profiles"] == ["tensorboard"]
    (runs,) = service["volumes"]
    assert runs == f"{compose['services']['learner']['volumes'][0]}:ro"
    assert service["networks"] == ["viewers"]
    assert all("networks" not in compose["services"][name] for name in ("learner", "actor", "evaluator"))
    assert [filled(port) for port in service["ports"]] == ["127.0.0.1:6006:6006"]
    assert service["read_only"] is True


def test_the_dashboard_sees_the_runs_and_nothing_else(compose: dict[str, Any]) -> None:
    """As TensorBoard: started when asked for, reads the volume alone, published on loopback; it asks for a token."""
    service = compose["services"]["dashboard"]
    assert service["profiles"] == ["dashboard"]
    (runs,) = service["volumes"]
    assert runs == f"{compose['services']['learner']['volumes'][0]}:ro"
    assert service["networks"] == ["viewers"]
    assert [filled(port) for port in service["ports"]] == ["127.0.0.1:6007:6007"]
    assert service["read_only"] is True
    assert "--new-token" in service["command"]
    given = cli.load_command("dashboard")
    parser = argparse.ArgumentParser()
    given.add_options(parser)
    options = parser.parse_args(service["command"][1:])
    assert (options.run_dir, options.host, options.port) == ([Path("/data/runs")], "0.0.0.0", 6007)


def test_the_router_is_no_part_of_the_run(compose: dict[str, Any]) -> None:
    """It is started when asked for, asks for certificates, and is on no network of the others."""
    service = compose["services"]["router"]
    assert service["profiles"] == ["router"]
    assert service["networks"] == ["hosts"]
    assert [filled(port) for port in service["ports"]] == ["7447:7447"]
    (certificates,) = service["volumes"]
    assert (filled(certificates["source"]), certificates["target"]) == ("./certs/learner", "/certs")
    assert certificates["read_only"] is True
    # The long form: of the short one Docker makes a folder where there is none. Compose 1.29 knows no further option.
    assert set(certificates) == {"type", "source", "target", "read_only"}
    assert not any("INSECURE" in name for name in service.get("environment", {}))
    assert "--insecure" not in service["command"]


def test_commands_are_those_there_are(compose: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """With the options that they are given: parsed as in the container, up to the work itself."""
    called: list[str] = []
    monkeypatch.setattr("services.learner.service.run_learner", lambda *_, **__: called.append("learner") or 0)
    monkeypatch.setattr("services.actor.service.run_actor", lambda *_, **__: called.append("actor") or 0)
    monkeypatch.setattr("services.evaluator.service.run_evaluator", lambda *_, **__: called.append("evaluator") or 0)
    monkeypatch.setattr("services.router.service.run_router", lambda *_, **__: called.append("router") or 0)
    monkeypatch.setattr("reskpn.commands.learner.run_to_resume", lambda _: None)
    for service in ("learner", "actor", "evaluator", "router"):
        words = [filled(word) for word in compose["services"][service]["command"]]
        assert cli.main(words) == 0
    assert called == ["learner", "actor", "evaluator", "router"]


@pytest.mark.parametrize("service", ["learner", "actor", "evaluator", "router"])
def test_checks_are_of_the_file_that_is_kept(compose: dict[str, Any], service: str) -> None:
    """The health check's options are possible, and its state file is the one that the service is told to keep."""
    check = compose["services"][service]["healthcheck"]["test"]
    assert check[:5] == ["CMD", "python", "-m", "reskpn.health", service]
    command = compose["services"][service]["command"]
    if "--state-file" in command:
        assert check[5:] == ["--state-file", command[command.index("--state-file") + 1]]
    if "--certificates" in command:
        assert check[-2:] == command[command.index("--certificates") :]


def test_every_target_is_a_stage(compose: dict[str, Any]) -> None:
    """Of the one Dockerfile, whose last stage is that of the services."""
    stages = [line.split() for line in (ROOT / "Dockerfile").read_text().splitlines() if line.startswith("FROM ")]
    names = {words[3] for words in stages if len(words) == 4}
    assert {service["build"]["target"] for service in compose["services"].values()} == {"service", "tensorboard"}
    assert {"service", "tensorboard"} <= names
    assert stages[-1] == ["FROM", "service"]


def test_the_image_is_made_of_what_the_build_may_see() -> None:
    """Every folder that the Dockerfile copies is let through by .dockerignore."""
    copied = [
        word
        for line in (ROOT / "Dockerfile").read_text().splitlines()
        if line.startswith("COPY ") and "--from" not in line
        for word in shlex.split(line)[1:-1]
    ]
    let_through = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert set(copied) == let_through
    assert all((ROOT / name).exists() for name in copied)
