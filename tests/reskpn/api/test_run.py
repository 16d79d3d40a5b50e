"""A recorded run opened in Python: arrays, records and policies."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import UPDATES

import reskpn
from common.errors import SettingsError
from reskpn.policy_file import load

pytestmark = pytest.mark.usefixtures("in_a_hurry")

ROOT = Path(__file__).parents[3]


def test_importing_is_quick() -> None:
    """Neither JAX nor anything else heavy is loaded; names are, when they are used."""
    program = (
        "import sys, reskpn; heavy = {'jax', 'numpy', 'pydantic', 'onnxruntime', 'zenoh', 'mujoco'}; "
        "assert not heavy & set(sys.modules); reskpn.open_run; assert 'jax' not in sys.modules; "
        "reskpn.train; assert not {'jax', 'onnxruntime', 'mujoco'} & set(sys.modules), sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, timeout=60)


def test_names() -> None:
    """All that is promised is there, and nothing else is made up."""
    assert set(reskpn.__all__) <= set(dir(reskpn))
    assert all(getattr(reskpn, name) is not None for name in reskpn.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        reskpn.nothing  # noqa: B018


def test_facts(run_dir: Path) -> None:
    """Of the four updates of the log; there is no summary, and the directory has no settings."""
    run = reskpn.open_run(run_dir)
    assert (run.version, run.summary, run.versions()) == (UPDATES, None, [2, 4])
    assert run.settings.task == "inverted_pendulum"
    assert repr(run) == f"<reskpn.Run {run.name}: reskpn on inverted_pendulum, version 4, {run.state}>"


def test_curves(run_dir: Path) -> None:
    """One number for each update: the metric is a tenth of the version; a return was not recorded."""
    curves = reskpn.open_run(run_dir).curves()
    np.testing.assert_array_equal(curves["version"], [1, 2, 3, 4])
    np.testing.assert_array_equal(curves["env_steps"], [12, 24, 36, 48])
    np.testing.assert_allclose(curves["train/kl"], [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(curves["seconds/wait"], [0.5] * 4)
    assert np.isnan(curves["return"]).all()


def test_frame(run_dir: Path) -> None:
    """The same by version."""
    frame = reskpn.open_run(run_dir).frame()
    assert frame.loc[3, "train/kl"] == pytest.approx(0.3)
    assert list(frame.index) == [1, 2, 3, 4]


def test_a_frame_without_pandas(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence says what to install, and what does without."""
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(reskpn.ReskpnError, match=r"pip install 'reskpn\[frames\]'; curves\(\) needs NumPy alone"):
        reskpn.open_run(run_dir).frame()


def test_policies(run_dir: Path, tmp_path: Path) -> None:
    """A version acts as its exported file does."""
    policy = reskpn.open_run(run_dir).policy(2)
    assert policy.version == 2
    observations = np.random.default_rng(0).normal(size=(5, 4))
    actions = policy.act(observations)
    assert (actions.shape, actions.dtype) == ((5, 1), np.float32)
    assert np.abs(actions).max() <= 1.0
    np.testing.assert_allclose(policy.act(observations[0]), actions[0], atol=1e-6)
    exported = load(policy.export(tmp_path / "policy.onnx"))
    assert exported.facts["digest"] == policy.digest
    np.testing.assert_allclose(exported.act(observations), actions, atol=1e-5)


def test_what_is_not_possible(run_dir: Path, tmp_path: Path) -> None:
    """A version that is not there, another task, a file of another ending, an observation of another shape."""
    run = reskpn.open_run(run_dir)
    with pytest.raises(SettingsError, match="has versions 0 to 4"):
        run.policy(9)
    with pytest.raises(SettingsError, match="the run is of task inverted_pendulum"):
        run.policy(task="hopper")
    policy = run.policy()
    with pytest.raises(SettingsError, match=r"ends in \.onnx, or in \.npz"):
        policy.export(tmp_path / "policy.pt")
    with pytest.raises(SettingsError, match=r"an observation of shape \[3\]; this policy takes \[4\]"):
        policy.act([1.0, 2.0, 3.0])
    with pytest.raises(reskpn.ReskpnError):
        reskpn.open_run(tmp_path / "absent")


def test_records(run_dir: Path) -> None:
    """Episodes and evaluations are records of the log, none in this one; updates come with their rollouts."""
    run = reskpn.open_run(run_dir)
    assert (run.episodes(), run.evaluations()) == ([], [])
    assert [len(update.rollouts) for update in run.updates()] == [2] * UPDATES
