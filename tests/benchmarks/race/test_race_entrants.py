"""The entrants of the race: who there is, what decides their runs, and how their progress is read."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import pytest

from benchmarks.peers import environment
from benchmarks.race.entrants import ENVIRONMENTS, OTHERS, Run, entrant, known_task
from benchmarks.race.wall import Report
from common.config.settings import RunSettings
from common.config.sources import PRESETS
from common.errors import LogReadError, ProcessError, SettingsError
from common.log.writer import LogWriter
from common.runs.directory import prepare_run_dir
from common.tasks import GYMNASIUM
from reskpn.cli import parse
from reskpn.commands.settings_options import settings_given
from reskpn.study.results import relevant, revision


def test_every_task_is_gymnasiums_and_ours() -> None:
    """Each name of the race stands for an environment of Gymnasium's registry and for a task of this project."""
    assert {name.lower() for name in ENVIRONMENTS.values()} == set(GYMNASIUM)
    for name, there in ENVIRONMENTS.items():
        assert there.lower() == f"{name}-v5"
        assert there in gymnasium.registry


@pytest.mark.parametrize("name", ["sb4", "defaultt", "missing.yaml"])
def test_an_unknown_entrant_is_one_sentence(name: str) -> None:
    with pytest.raises(
        SettingsError, match=f"'{name}' is not a known entrant; .*sb3, sbx, reference, rsl_rl, brax, or a .yaml file"
    ):
        entrant(name)


def test_an_unknown_task_is_one_sentence() -> None:
    with pytest.raises(SettingsError, match="'hoper' is not a task of the race; did you mean 'hopper'"):
        known_task("hoper")


@pytest.mark.parametrize("name", ["sb3", "sbx", "rsl_rl"])
def test_a_peer_that_is_not_installed_is_one_sentence(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(environment, "ROOT", tmp_path)
    monkeypatch.setattr(environment, "PYTHON", tmp_path / "build" / "python")
    with pytest.raises(ProcessError, match=r"the peers are not installed .*`make peers`"):
        entrant(name).command(Run("hopper", 0, tmp_path))


@pytest.mark.parametrize("name", [*PRESETS, *OTHERS])
def test_a_run_is_decided_by_its_entrant_and_task(name: str) -> None:
    """The same again gives the same digest; another task or entrant another one."""
    assert entrant(name).identity("hopper") == entrant(name).identity("hopper")
    others = {entrant(other).identity("hopper") for other in [*PRESETS, *OTHERS] if other != name}
    assert entrant(name).identity("hopper") not in others | {entrant(name).identity("walker2d")}


def test_a_file_of_settings_is_an_entrant_by_its_content(tmp_path: Path) -> None:
    """Named by its stem; another learning rate is another entrant."""
    file = tmp_path / "mine.yaml"
    file.write_text("learner: ppo\n")
    before = entrant(str(file)).identity("hopper")
    file.write_text("learner: ppo\nalgorithm: {learning_rate: 1e-3}\n")
    changed = entrant(str(file))
    assert changed.name == "mine"
    assert changed.identity("hopper") != before
    command = changed.command(Run("reacher", 3, tmp_path))
    assert command[command.index("--config") + 1] == str(file)
    assert command[command.index("--task") + 1] == "reacher-v5"
    assert command[command.index("--seed") + 1] == "3"


def test_our_episodes_are_as_long_as_gymnasiums_and_start_anew() -> None:
    """As `Reacher-v5`: 50 steps, each episode in a state drawn for it."""
    decided = entrant("paper").decided_by("reacher")
    assert (decided["task"], decided["episode_length"], decided["initial_states"]) == ("reacher-v5", 50, "new")
    reference = entrant("reference").decided_by("reacher")
    assert (reference["task"], reference["episode_length"], reference["new_states"]) == ("reacher-v5", 50, True)


def test_a_run_that_had_not_begun_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(LogReadError, match="default did not get as far as its settings"):
        entrant("default").progress(Run("hopper", 0, tmp_path), [], 0.0)


def test_settings_that_are_impossible_on_a_task_are_one_sentence() -> None:
    """Reacher's episodes have 50 steps."""
    with pytest.raises(SettingsError, match=r"default cannot run on reacher: num_steps \(128\) must not be longer"):
        entrant("default").identity("reacher")


def test_our_command_is_what_decides_the_run(tmp_path: Path) -> None:
    """Read as `reskpn train` reads it, it gives the settings by which the result is found again."""
    words = entrant("default").command(Run("hopper", 0, tmp_path))
    given, _ = parse(words[words.index("reskpn") + 1 :])
    settings = settings_given(given)
    assert relevant(settings) | {"revision": revision(settings)} == entrant("default").decided_by("hopper")
    assert settings.run_dir == tmp_path / "run"


def test_our_progress_is_read_from_the_log(tmp_path: Path) -> None:
    """Two updates at 5 and 8 s after the launch; two episodes with mean 30 ended in the first, none in the second."""
    settings = RunSettings(task="hopper-v5", learner="ppo", run_dir=tmp_path / "run")
    run_dir = prepare_run_dir(settings)
    with LogWriter(run_dir / "log") as log:
        log.write("/episode", {"version": 1, "count": 2, "return_mean": 30.0}, t_ns=1_005 * 10**9)
        log.write("/update", {"version": 1, "env_steps": 640}, t_ns=1_005 * 10**9)
        log.write("/update", {"version": 2, "env_steps": 1280}, t_ns=1_008 * 10**9)
    about, reports = entrant("default").progress(Run("hopper", 0, tmp_path), [], 1_000.0)
    assert reports == [Report(5.0, 640, 2, 60.0), Report(8.0, 1280, 0, 0.0)]
    assert about["settings"]["learner"] == "ppo"
    assert "jax" in about["versions"]
