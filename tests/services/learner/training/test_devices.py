"""A learner over several devices computes what it computes on one, to rounding."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from quick_compiler import FLAGS

from common.config.settings import RunSettings
from common.errors import SettingsError
from services.learner.training.devices import device_mesh

SERVICES = Path(__file__).parents[2]

SCRIPT = """
import json
import numpy as np
from samples import rollout
from common.config.settings import RunSettings
from services.learner.training.trainer import Trainer

SIZES = {"num_envs": 4, "num_steps": 3, "actors": 2, "total_steps": 48}
ALGORITHM = {"hidden": (8,), "minibatches": 3}
states = []
for devices in (1, 2):
    trainer = Trainer(RunSettings.model_validate(SIZES | {"algorithm": ALGORITHM | {"devices": devices}}))
    trainer.compile()
    for version in range(2):
        trainer.update([rollout(slot, "a", seq=version, policy_version=version) for slot in range(2)])
    trainer.restore(trainer.state_arrays())
    states.append(trainer.state_arrays())
one, two = states
print(json.dumps({
    "names": sorted(one) == sorted(two),
    "apart": max(float(np.max(np.abs(one[name].astype(float) - two[name]), initial=0.0)) for name in one),
    "moved": float(np.max(np.abs(one["parameters/policy/features/layers/0/bias"]))),
}))
"""


def test_two_devices_compute_what_one_does() -> None:
    """Two updates with two halves of every minibatch: the same state to 1e-4, after parameters moved by more."""
    paths = [str(SERVICES), *map(str, SERVICES.parents[:2])]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "JAX_PLATFORMS": "cpu",
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
        "XLA_FLAGS": " ".join(["--xla_force_host_platform_device_count=2", *FLAGS]),
    }
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["names"]
    assert found["apart"] < 1e-4
    assert found["moved"] > 1e-3


def test_devices_that_are_not_there() -> None:
    """The sentence says how many there are, and how a CPU gets more."""
    with pytest.raises(SettingsError, match=r"algorithm.devices is 4096, and JAX finds \d+ here"):
        device_mesh(4096)


def test_devices_divide_a_minibatch() -> None:
    """Four environments, three steps and three minibatches leave four transitions each, which three cannot share."""
    sizes = {"num_envs": 4, "num_steps": 3, "actors": 2, "total_steps": 48}
    with pytest.raises(ValueError, match=r"algorithm.devices \(3\) must divide a minibatch, of 4 transitions"):
        RunSettings.model_validate(sizes | {"algorithm": {"minibatches": 3, "devices": 3}})
