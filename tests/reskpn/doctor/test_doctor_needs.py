"""What a run needs, against the bytes that it writes."""

from __future__ import annotations

import numpy as np
import pytest
from mirrors import no_mirror

from common.config.settings import RunSettings
from common.runs.directory import KEPT_CHECKPOINTS
from common.wire.rollout import Rollout
from reskpn.doctor.needs import PROCESS_BYTES, UPDATE_BYTES, needs, rollout_bytes

SETTINGS = RunSettings.model_validate(
    {"task": "hopper", "actors": 2, "num_envs": 64, "num_steps": 10, "total_steps": 64_000, "log": {"policy_every": 25}}
)


def test_the_size_of_a_rollout() -> None:
    """Hopper, 32 environments, 10 steps: the message itself, to a tenth."""
    steps, envs, observation, action = 10, 32, 11, 3
    message = Rollout(
        "hopper-ppo-s0-ab12", 0, "5f31aa0012bb34cc", 10, 10, 10**18,
        np.zeros((steps, envs, observation), np.float32), np.zeros((steps, envs, action), np.float32),
        np.zeros((steps, envs), np.float32), np.zeros((steps, envs), np.float32),
        np.zeros((steps, envs), bool), np.zeros((steps, envs), bool), np.zeros((envs, observation), np.float32),
        np.zeros((0, observation), np.float32), np.zeros(2, np.float32), np.ones(2, np.int32), {"collect": 0.5},
        **no_mirror(observation, action),
    )  # fmt: skip
    assert rollout_bytes(SETTINGS) == pytest.approx(len(message.encode()), rel=0.1)


def test_the_needs_of_a_run() -> None:
    """100 updates of 2 rollouts; policies of 1 kB at 25, 50, 75 and 100 and one at most besides; 3 checkpoints."""
    needed = needs(SETTINGS, 1000, 10_000)
    rollout = rollout_bytes(SETTINGS)
    assert needed.log == 100 * (2 * rollout + UPDATE_BYTES) + 5 * 1000 + KEPT_CHECKPOINTS * 10_000
    # Three processes.
    assert needed.memory == pytest.approx(3 * PROCESS_BYTES, rel=0.01)
