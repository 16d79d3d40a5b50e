"""`reskpn learner`: the settings that a new run begins with."""

import pytest

from common.config.settings import RunSettings
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
