"""The settings of a resumed run: those it began with, and a sentence for what would make it another run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from common.config.settings import RunSettings
from common.config.sources import load_over
from common.errors import LogReadError, SettingsError
from common.log.writer import LogWriter
from common.runs.resumed_settings import Interrupted, holds_run, read_interrupted, resumed_settings

BASE: dict[str, Any] = {"num_envs": 8, "num_steps": 8, "total_steps": 640, "algorithm": {"minibatches": 2}}


def interrupted(folder: Path, **changes: Any) -> Interrupted:
    settings = RunSettings.model_validate(BASE | changes)
    with LogWriter(folder / "log", metadata={"settings": {"json": settings.model_dump_json()}}):
        pass
    return read_interrupted(folder)


def given(**environment: str) -> Callable[[RunSettings], RunSettings]:
    """What the environment gives, over the settings of the run."""
    names = {f"RESKPN_{name.upper()}": value for name, value in environment.items()}
    return lambda base: load_over(base, environment=names)


def test_settings_are_those_of_the_log(tmp_path: Path) -> None:
    """Wherever the directory is now, and whatever the defaults have become."""
    found = interrupted(tmp_path, run_dir="/elsewhere", seed=5)
    settings = resumed_settings(found, given())
    assert (settings.seed, settings.total_steps, settings.run_dir) == (5, 640, tmp_path)
    assert not found.complete


def test_transport_may_change(tmp_path: Path) -> None:
    """It decides nothing of what is learned."""
    settings = resumed_settings(interrupted(tmp_path), given(transport__endpoint="tcp/127.0.0.1:9"))
    assert settings.transport.endpoint == "tcp/127.0.0.1:9"


def test_an_endpoint_that_is_nobodys_is_left_open(tmp_path: Path) -> None:
    """`train` chooses a port, unless it is told one; the rest of the transport stays."""
    base = interrupted(tmp_path, transport={"endpoint": "tcp/127.0.0.1:9", "lease_s": 7}).settings
    settings = load_over(base, environment={}, own_endpoint=False)
    assert "endpoint" not in settings.transport.model_fields_set
    assert settings.transport.lease_s == 7
    told = load_over(base, environment={"RESKPN_TRANSPORT__ENDPOINT": "tcp/127.0.0.1:8"}, own_endpoint=False)
    assert "endpoint" in told.transport.model_fields_set


def test_what_is_given_again_is_no_change(tmp_path: Path) -> None:
    """The same command line with `--resume` works."""
    assert resumed_settings(interrupted(tmp_path, seed=5), given(seed="5", total_steps="6.4e2")).seed == 5


def test_other_changes_are_refused(tmp_path: Path) -> None:
    """All of them are named, with both values."""
    with pytest.raises(SettingsError) as refused:
        resumed_settings(interrupted(tmp_path), given(seed="3", algorithm__gamma="0.5"))
    assert "leave out seed (it is 0, given 3), algorithm.gamma (it is 0.99, given 0.5), or start another" in str(
        refused.value
    )


def test_more_steps_extend_a_run(tmp_path: Path) -> None:
    """With the room for h that it began with, since the state has that size: 10 updates of one sample."""
    settings = resumed_settings(interrupted(tmp_path), given(total_steps="1280"))
    assert (settings.updates, settings.capacity, settings.rkhs.capacity) == (20, 10, 10)
    # As `train` hands it on to its learner, which reads the run's own settings again.
    again = resumed_settings(interrupted(tmp_path), given(total_steps="1280", rkhs__capacity="10"))
    assert again == settings


def test_an_automatic_precision_is_the_one_it_began_with(tmp_path: Path) -> None:
    """`auto` given again is no change: the run keeps what it chose when it began, on whatever machine it goes on."""
    settings = resumed_settings(interrupted(tmp_path), given(algorithm__precision="auto"))
    assert settings.algorithm.precision == "float32"
    with pytest.raises(SettingsError, match=r'algorithm.precision \(it is "float32", given "bfloat16"\)'):
        resumed_settings(interrupted(tmp_path), given(algorithm__precision="bfloat16"))


def test_fewer_steps_are_refused(tmp_path: Path) -> None:
    """What was done cannot be undone."""
    with pytest.raises(SettingsError, match="total_steps 64 is less than the run's 640"):
        resumed_settings(interrupted(tmp_path), given(total_steps="64"))


def test_another_directory_is_refused(tmp_path: Path) -> None:
    """A run stays where its log is."""
    with pytest.raises(SettingsError, match="the run stays there; leave out run_dir /elsewhere"):
        resumed_settings(interrupted(tmp_path), given(run_dir="/elsewhere"))


@pytest.mark.parametrize(
    ("summary", "complete"), [({"complete": True}, True), ({"complete": False}, False), ([], False)]
)
def test_a_run_is_complete_when_its_summary_says_so(tmp_path: Path, summary: Any, complete: bool) -> None:
    """One that was stopped has a summary, too."""
    interrupted(tmp_path)
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    assert read_interrupted(tmp_path).complete is complete


def test_a_directory_without_a_run(tmp_path: Path) -> None:
    """Is refused with what is looked for; an empty one holds none."""
    assert not holds_run(tmp_path)
    with pytest.raises(SettingsError, match="no run was begun there; give the directory of a run"):
        read_interrupted(tmp_path)


def test_a_run_that_had_no_log_yet(tmp_path: Path) -> None:
    """Killed at its very start, it has its settings beside the log."""
    text = RunSettings.model_validate(BASE | {"seed": 6}).model_dump_json()
    (tmp_path / "settings.json").write_text(text)
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "00000.mcap").write_bytes(b"")
    assert holds_run(tmp_path)
    assert read_interrupted(tmp_path).settings.seed == 6


def test_a_run_without_settings(tmp_path: Path) -> None:
    """Nobody knows what it was."""
    with LogWriter(tmp_path / "log"):
        pass
    with pytest.raises(LogReadError, match=r"neither the log in .* nor settings\.json says what the run was"):
        read_interrupted(tmp_path)
