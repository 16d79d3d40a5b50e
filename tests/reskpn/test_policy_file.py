"""Exported policies opened: actions, and a sentence for files and observations that do not fit."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from common.errors import PolicyFileError
from common.runs.recorded_run import open_run
from reskpn.cli import main
from reskpn.export.policy import TrainedPolicy
from reskpn.export.verify import logged_observations
from reskpn.policy_file import KEY, SIMULATION, load, pack, unpack

ROOT = Path(__file__).parents[2]


def test_one_observation_and_several(exported: Path) -> None:
    """The action of one is the row of several."""
    policy = load(exported)
    observations = np.array([[0.1, -0.2, 0.3, 0.4], [9.0, -9.0, 9.0, -9.0]])
    actions = policy.act(observations)
    assert (actions.shape, actions.dtype) == ((2, 1), np.float32)
    np.testing.assert_array_equal(policy.act(list(observations[1])), actions[1])
    assert np.abs(actions).max() <= 1.0


def test_facts(exported: Path, policy: TrainedPolicy) -> None:
    """The file says what it takes, what it gives, and where it is from."""
    facts = load(exported).facts
    assert facts["task"] == "inverted_pendulum"
    assert facts["observation"]["layout"] == ["qpos slider", "qpos hinge", "qvel slider", "qvel hinge"]
    assert (facts["action"]["size"], facts["action"]["low"], facts["action"]["high"]) == (1, -1.0, 1.0)
    assert facts["action"]["command_ranges"] == [[-3.0, 3.0]]
    assert (facts["version"], facts["digest"]) == (policy.version, policy.digest)
    assert facts["step_s"] == pytest.approx(0.04)
    assert "jax" in facts["versions"]


def test_for_jax(run_dir: Path, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The archive gives the actions of the ONNX file; its arrays are those of the policy."""
    out = tmp_path / "policy.npz"
    assert main(["export", str(run_dir), "--format", "jax", "--out", str(out)]) == 0
    capsys.readouterr()
    observations = logged_observations(open_run(run_dir))
    np.testing.assert_allclose(load(out).act(observations), load(exported).act(observations), atol=1e-5, rtol=0)
    with np.load(out, allow_pickle=False) as archive:
        assert archive["arrays/observations/mean"].shape == (4,)
    assert main(["play", str(out)]) == 5
    assert "cannot be played: `reskpn play` plays ONNX files" in capsys.readouterr().err


@pytest.mark.parametrize("shape", [(3,), (5, 5), (1, 1, 4), ()])
def test_an_observation_of_another_shape(exported: Path, shape: tuple[int, ...]) -> None:
    """Given and wanted shape are named."""
    with pytest.raises(PolicyFileError, match=r"an observation of shape .* takes \[4\], or \[B, 4\]"):
        load(exported).act(np.zeros(shape))


def test_an_observation_that_is_not_finite(exported: Path) -> None:
    """No action follows from a broken sensor."""
    with pytest.raises(PolicyFileError, match="not finite"):
        load(exported).act([0.0, float("nan"), 0.0, 0.0])


def test_files_that_are_none(tmp_path: Path) -> None:
    """One that is absent, one of other bytes, an archive of other arrays."""
    with pytest.raises(PolicyFileError, match="cannot be read"):
        load(tmp_path / "absent.onnx")
    other = tmp_path / "other.onnx"
    other.write_bytes(b"not a model")
    with pytest.raises(PolicyFileError, match="is not an ONNX file"):
        load(other)
    archive = tmp_path / "other.npz"
    np.savez(archive, x=np.zeros(3))
    with pytest.raises(PolicyFileError, match="was not made by `reskpn export`"):
        load(archive)
    archive.write_bytes(b"not an archive")
    with pytest.raises(PolicyFileError, match="is not an archive"):
        load(archive)


def test_a_file_of_another_program(with_metadata: Callable[[str, str | None], Path]) -> None:
    """ONNX Runtime can run it, but it does not say what it is."""
    with pytest.raises(PolicyFileError, match="was not made by `reskpn export`"):
        load(with_metadata(KEY, None))


def test_a_file_of_a_later_format(with_metadata: Callable[[str, str | None], Path]) -> None:
    """Both numbers are named."""
    with pytest.raises(PolicyFileError, match="of format 9, this version reads format 1"):
        load(with_metadata(KEY, json.dumps({"format": 9})))


def test_a_damaged_simulation(with_metadata: Callable[[str, str | None], Path]) -> None:
    """The policy itself may be sound, but the file is not the one that was written."""
    with pytest.raises(PolicyFileError, match="is damaged"):
        load(with_metadata(SIMULATION, "xxxx"))


def test_packed_values_come_back() -> None:
    """Text, numbers, bytes and arrays."""
    array = np.arange(6, dtype=np.float32).reshape(2, 3)
    content = unpack(pack({"n": 3, "names": ["a"], "data": b"\x00\xff", "array": array}))
    assert (content["n"], content["names"], content["data"]) == (3, ["a"], b"\x00\xff")
    np.testing.assert_array_equal(content["array"], array)


LIGHT = """
import runpy, sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"jax", "jaxlib", "flax", "brax", "zenoh", "pydantic", "mcap", "onnx"}:
            raise ImportError(name)
sys.meta_path.insert(0, Blocked())
"""


def light(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A program in an environment where neither JAX nor anything of a run can be imported."""
    command = [sys.executable, "-c", LIGHT + program, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


def test_playing_needs_onnxruntime_and_mujoco_alone(exported: Path) -> None:
    """Four episodes, to the end."""
    program = "from reskpn.cli import main; code = main(sys.argv[1:]); assert 'jax' not in sys.modules; sys.exit(code)"
    done = light(program, "play", str(exported), "--task", "inverted_pendulum", "--episodes", "4", "--json")
    assert done.returncode == 0, done.stderr
    played = json.loads(done.stdout)
    assert len(played["returns"]) == 4
    assert all(length >= 1 for length in played["lengths"])


def test_the_example_of_a_control_loop(exported: Path) -> None:
    """A hundred actions, of one actuator each."""
    program = "sys.argv = sys.argv[1:]; import time; time.sleep = lambda s: None; runpy.run_path(sys.argv[0])"
    done = light(program, "examples/robot_loop.py", str(exported))
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 100
