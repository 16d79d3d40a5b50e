"""A recorded run of two slots on inverted_pendulum, made in this process, and its exported policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import UPDATES, made_up, trainer_settings, write_log

from common.runs.recorded_run import open_run
from common.wire.messages import Snapshot, digest_arrays
from reskpn.cli import main
from reskpn.export.policy import TrainedPolicy, trained_policy
from services.learner.training.trainer import Trainer


def bent(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Other numbers in the same arrays, so that every part of the policy shows in its actions."""
    rng = np.random.default_rng(0)
    found = {name: np.asarray(array + rng.normal(0.0, 0.3, array.shape), array.dtype) for name, array in arrays.items()}
    return found | {name: np.asarray(np.abs(array)) for name, array in found.items() if "observations" in name}


@pytest.fixture(scope="session")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four updates; the log holds a policy of version 2 and one of version 4."""
    policy = bent(Trainer(trainer_settings()).policy_arrays())
    snapshots = [
        ("/policy", Snapshot("run-1", version, digest_arrays(policy), policy).encode()) for version in (2, UPDATES)
    ]
    return write_log(tmp_path_factory.mktemp("exported") / "run", [*made_up().messages, *snapshots])


@pytest.fixture(scope="session")
def policy(run_dir: Path) -> TrainedPolicy:
    return trained_policy(open_run(run_dir), None)


@pytest.fixture(scope="session")
def exported(run_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run's newest policy as ONNX."""
    out = tmp_path_factory.mktemp("files") / "policy.onnx"
    assert main(["export", str(run_dir), "--out", str(out)]) == 0
    return out


@pytest.fixture
def with_metadata(exported: Path, tmp_path: Path) -> Callable[[str, str | None], Path]:
    """The exported file with one entry of its metadata replaced, or taken out."""
    import onnx

    def change(key: str, value: str | None) -> Path:
        model = onnx.load(str(exported))
        kept = {entry.key: entry.value for entry in model.metadata_props if entry.key != key}
        del model.metadata_props[:]
        onnx.helper.set_model_props(model, kept | ({} if value is None else {key: value}))
        path = tmp_path / "changed.onnx"
        onnx.save(model, str(path))
        return path

    return change
