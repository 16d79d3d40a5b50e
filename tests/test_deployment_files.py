"""docker-compose.yml and what belongs to it agree with the code."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from common.settings import RunSettings
from common.settings_sources import load
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


@pytest.mark.parametrize("service", ["learner", "actor"])
def test_what_the_file_sets_is_possible(compose: dict[str, Any], service: str) -> None:
    """The settings it gives are accepted; they leave its network closed."""
    given = {name: filled(value) for name, value in compose["services"][service]["environment"].items()}
    settings = load(environment=given)
    assert settings.actors == 4
    assert settings.slot_wait_s == 15.0
    assert set(given) == OWN
    assert compose["networks"]["default"]["internal"] is True
    assert "ports" not in compose["services"][service]


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
