"""`reskpn learner`: the settings that a new run begins with."""

import os
from pathlib import Path

import pytest

from common.config.settings import RunSettings
from common.errors import SettingsError
from reskpn.cli import main
from reskpn.commands import learner


def test_automatic_precision_is_chosen_and_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The run begins with the value that this machine was given, and the screen says which and why."""
    monkeypatch.setattr("common.precision.choose_precision", lambda: ("bfloat16", "it has the instruction"))
    settings = RunSettings.model_validate({"algorithm": {"precision": "auto"}})
    assert learner._with_precision_chosen(settings).algorithm.precision == "bfloat16"
    assert "algorithm.precision auto is bfloat16 here: it has the instruction" in capsys.readouterr().out
    assert learner._with_precision_chosen(RunSettings()) == RunSettings()


def test_the_learner_takes_its_share_of_the_gpu_before_jax_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the service finds in the environment is what the settings say; `on-demand` is what any command finds."""
    found: list[dict[str, str]] = []

    def run_learner(settings: RunSettings, **_: object) -> int:
        found.append({name: value for name, value in os.environ.items() if name.startswith("XLA_")})
        return 0

    monkeypatch.setattr("services.learner.service.run_learner", run_learner)
    for words in ([], ["--device-memory.learner", "0.4"]):
        with monkeypatch.context() as patch:
            patch.setattr(os, "environ", {name: os.environ[name] for name in os.environ if not name.startswith("XLA_")})
            assert main(["learner", *words]) == 0
    assert found == [
        {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"},
        {"XLA_PYTHON_CLIENT_PREALLOCATE": "true", "XLA_CLIENT_MEM_FRACTION": "0.4"},
    ]


@pytest.mark.parametrize("command", ["learner", "train"])
def test_a_trace_of_what_will_not_be_made_is_refused(
    capsys: pytest.CaptureFixture[str], command: str, tmp_path: Path
) -> None:
    """2 updates of 20,480 steps; and what is no number of updates at all. Nothing is left behind."""
    words = [command, "--config", "paper", "--total-steps", "40960", "--run-dir", str(tmp_path / "run")]
    assert main([*words, "--trace", "1@3"]) == SettingsError.exit_code
    assert "--trace 1@3: the run ends at version 2" in capsys.readouterr().err
    assert main([*words, "--trace", "all"]) == SettingsError.exit_code
    assert "--trace all: write N for the number of updates" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
