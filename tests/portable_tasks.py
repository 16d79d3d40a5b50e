"""A task packed for `reskpn play` against its environment, step by step."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np

from common.config.settings import RunSettings
from common.physics.environments import make_environment
from common.physics.step_functions import StepFunctions
from reskpn.export.simulation import packed_simulation
from reskpn.playing import open_simulation
from reskpn.policy_file import Policy
from services.worker.deterministic import STARTS

STEPS = 12


def check_portable(task: str) -> None:
    """Twelve steps of the same actions, some beyond [-1, 1], from the first state: same observations and rewards."""
    settings = RunSettings(task=task)
    functions = StepFunctions(task)
    simulation = open_simulation(
        Policy(Path("made.onnx"), {}, lambda observations: observations, packed_simulation(functions, settings))
    )
    environment = make_environment(task, "native", num_envs=1, threads=1)
    state = environment.reset(jax.random.fold_in(jax.random.key(settings.seed), STARTS))
    obs = simulation.reset(0)
    # Body velocities come from a difference that the engine takes in float64 and the file in float32.
    close = {"rtol": 1e-4, "atol": 1e-4}
    np.testing.assert_allclose(obs, np.asarray(state.obs[0]), **close)
    rng = np.random.default_rng(0)
    for _ in range(STEPS):
        action = rng.uniform(-1.5, 1.5, environment.action_size).astype(np.float32)
        state, transition = environment.step(state, action[None])
        obs, reward, over = simulation.step(action)
        np.testing.assert_allclose(obs, np.asarray(transition.next_obs[0]), **close)
        np.testing.assert_allclose(reward, float(transition.reward[0]), **close)
        assert over == bool(transition.terminated[0] | transition.truncated[0])
        if over:
            break
