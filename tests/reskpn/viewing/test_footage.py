"""The trajectories of a log, the choice of one, and the sentences for what is not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from logs import divergence, motion, motions, usual_log, write_log

from common.errors import LogReadError, SettingsError
from reskpn.viewing.footage import Take, choose, diverged_takes, read_footage


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return usual_log(tmp_path_factory.mktemp("run"))


def chosen(path: Path, version: int | None = None, episode: int = 0, diverged: bool = False) -> Take:
    return choose(read_footage(path), version=version, episode=episode, diverged=diverged)


def test_takes_come_by_version_the_run_s_own_first(run_dir: Path) -> None:
    """Version 20 has the run's episode of 60 steps and the evaluator's of 50 and 40, numbered in that order."""
    footage = read_footage(run_dir)
    assert (footage.run, footage.task, footage.versions) == ("cart-1", "cart", [0, 20])
    assert [(take.version, take.episode, take.source, take.motion.steps) for take in footage.evaluated] == [
        (0, 0, "evaluator-e1", 30),
        (20, 0, "run", 60),
        (20, 1, "evaluator-e1", 50),
        (20, 2, "evaluator-e1", 40),
    ]
    assert chosen(run_dir).motion.steps == 60
    assert chosen(run_dir, version=0).motion.steps == 30
    # 40 steps of 0.04 s: the state before the last one is at 39 * 0.04 s
    assert chosen(run_dir, episode=2).seconds == pytest.approx(1.56)
    np.testing.assert_array_equal(chosen(run_dir, episode=2).motion.qpos[:, 0], motion(40, 1.0).qpos[:, 0])


def test_diverged_simulations_are_takes_of_their_own(run_dir: Path) -> None:
    """Numbered over the run, or over one version."""
    assert [take.motion.steps for take in diverged_takes(read_footage(run_dir))] == [5, 51]
    assert chosen(run_dir, diverged=True, episode=1).version == 20
    only = chosen(run_dir, diverged=True, version=20)
    assert only.motion.steps == 51
    assert only.name == "divergence 0: policy 20, step 4 of environment 3 in rollout 7 of slot 1"


def test_an_evaluation_that_is_logged_twice_counts_once(tmp_path: Path) -> None:
    """As after a kill between trajectory and record: the later one is shown."""
    path = write_log(tmp_path, ("/motion", motions(4, [3], "run")), ("/motion", motions(4, [7], "run")))
    assert [take.motion.steps for take in read_footage(path).evaluated] == [7]


@pytest.mark.parametrize(
    ("version", "episode", "diverged", "sentence"),
    [
        (7, 0, False, "--version is 7; the log has trajectories of versions 0, 20"),
        (20, 3, False, "--episode is 3; the log has 3 trajectories of version 20, counted from 0"),
        (20, -1, False, "--episode is -1; the log has 3 trajectories of version 20, counted from 0"),
        (None, 2, True, "--episode is 2; the log has 2 diverged simulations, counted from 0"),
        (0, 0, True, "--version is 0; simulations diverged under versions 10, 20"),
    ],
)
def test_what_is_not_there_is_named_with_what_is(
    run_dir: Path, version: int | None, episode: int, diverged: bool, sentence: str
) -> None:
    """One sentence each."""
    with pytest.raises(SettingsError) as caught:
        chosen(run_dir, version, episode, diverged)
    assert str(caught.value) == sentence


def test_a_log_without_trajectories(tmp_path: Path) -> None:
    """Says what leaves them there, and for diverged simulations as well."""
    path = write_log(tmp_path)
    with pytest.raises(LogReadError, match="has no trajectories; evaluations leave them there, unless"):
        chosen(path)
    with pytest.raises(LogReadError, match=r"has no diverged simulation; none diverged, log\.divergences is 0"):
        chosen(path, diverged=True)


def test_what_is_no_log(tmp_path: Path) -> None:
    """Another file, a folder without a log, a log that is damaged inside."""
    (tmp_path / "notes.mcap").write_text("not a log")
    with pytest.raises(LogReadError, match="is not an MCAP file; give the log of a run"):
        read_footage(tmp_path / "notes.mcap")
    with pytest.raises(LogReadError):
        read_footage(tmp_path / "nowhere")
    path = write_log(tmp_path / "run", ("/motion", divergence(3)))
    with pytest.raises(LogReadError, match="message 1 of /motion cannot be read: Motions with"):
        read_footage(path)
