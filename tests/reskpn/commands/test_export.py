"""`reskpn export`: which version it writes, and that nothing is left of a file that is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recorded_runs import made_up, write_log

import reskpn.export.verify
from common.log.segments import LOG_DIRECTORY
from common.runs.recorded_run import open_run
from reskpn.cli import main
from reskpn.export.verify import logged_observations
from reskpn.policy_file import load

pytestmark = pytest.mark.usefixtures("in_a_hurry")

Output = pytest.CaptureFixture[str]


def export(*words: object) -> int:
    return main(["export", *map(str, words)])


def test_the_newest_policy_of_the_log(run_dir: Path, tmp_path: Path, capsys: Output) -> None:
    """Its version, digest and size are printed, with the difference, the observations and the latency.

    The last two rollouts that were used, and the one that came too late, and one more: T = 3, N = 2, four of them.
    """
    out = tmp_path / "policy.onnx"
    assert export(run_dir, "--out", out) == 0
    first, second, third = capsys.readouterr().out.splitlines()
    assert ": policy 4 of 4, digest " in first
    assert second.startswith(f"{out}: ")
    assert second.endswith(" on 24 logged observations")
    assert third.startswith("an action takes ")
    assert list(tmp_path.iterdir()) == [out]


def test_a_version_that_was_asked_for(run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without --out the file is here, named after task, learner and version."""
    monkeypatch.chdir(tmp_path)
    assert export(run_dir, "--version", "2") == 0
    assert load("inverted_pendulum-reskpn-v2.onnx").facts["version"] == 2


def test_a_run_that_is_cut(run_dir: Path, tmp_path: Path, capsys: Output) -> None:
    """The end is missing, as after a kill or while the run is going: the newest policy before it is exported."""
    cut = tmp_path / "cut" / LOG_DIRECTORY
    cut.mkdir(parents=True)
    (segment,) = (run_dir / LOG_DIRECTORY).glob("*.mcap")
    torn = segment.read_bytes()
    (cut / segment.name).write_bytes(torn[: len(torn) * 3 // 4])
    out = tmp_path / "policy.onnx"
    assert export(tmp_path / "cut", "--out", out) == 0
    assert load(out).facts["version"] in (2, 4)
    assert ": policy " in capsys.readouterr().out


def test_a_file_that_acts_otherwise_is_not_left(
    run_dir: Path, tmp_path: Path, capsys: Output, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With no difference allowed at all the file is refused; what stood under its name before stays."""
    monkeypatch.setattr(reskpn.export.verify, "TOLERANCE", -1.0)
    out = tmp_path / "policy.onnx"
    out.write_bytes(b"an older file")
    assert export(run_dir, "--out", out) == 7
    assert "differs from the trained one by" in capsys.readouterr().err
    assert out.read_bytes() == b"an older file"
    assert list(tmp_path.iterdir()) == [out]


def test_a_log_without_rollouts(tmp_path: Path) -> None:
    """There is nothing to verify the file on."""
    recording = made_up()
    messages = [message for message in recording.messages if message[0] in ("/spec", "/event")]
    run = open_run(write_log(tmp_path / "run", messages))
    with pytest.raises(reskpn.export.verify.LogReadError, match="has no rollout yet"):
        logged_observations(run)


def test_observations_are_the_newest_ones(run_dir: Path) -> None:
    """As many as four rollouts have, all finite."""
    observations = logged_observations(open_run(run_dir))
    assert (observations.shape, observations.dtype) == ((24, 4), np.float32)
    assert np.isfinite(observations).all()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--version", "-1"], "--version is -1; allowed: 0 or more"),
        (["--version", "9"], "--version 9: the log of "),
        (["--out", "x.npz"], "--out x.npz: a file of format onnx ends in .onnx"),
        (["--format", "jax", "--out", "x.onnx"], "--out x.onnx: a file of format jax ends in .npz"),
        (["--out", "/absent/x.onnx"], "--out /absent/x.onnx: there is no folder /absent; create it first"),
    ],
)
def test_what_is_not_possible(run_dir: Path, capsys: Output, words: list[str], sentence: str) -> None:
    """One sentence, exit code 2."""
    assert export(run_dir, *words) == 2
    assert capsys.readouterr().err.startswith(f"reskpn export: {sentence}")


def test_no_run_there(tmp_path: Path, capsys: Output) -> None:
    """Exit code 5, as of every log that cannot be read."""
    assert export(tmp_path) == 5
    assert "Traceback" not in capsys.readouterr().err
