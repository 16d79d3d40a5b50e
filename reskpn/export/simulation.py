"""The physics of a task, packed so that `reskpn play` needs MuJoCo and ONNX Runtime alone."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnx

from common.config.settings import RunSettings
from common.physics.portable import model_bytes
from common.physics.step_functions import StepFunctions
from reskpn.export.translate import to_onnx
from services.worker.deterministic import STARTS

FIRST_STATES = 1024
"""First states in a file, of which an episode takes one."""


def packed_simulation(functions: StepFunctions, settings: RunSettings) -> dict[str, Any]:
    """The content of `reskpn.policy_file.SIMULATION`. NotTranslatable where the task does what ONNX cannot."""
    qpos, qvel = first_states(functions, settings)
    return {
        "model": model_bytes(functions.model),
        "mujoco_version": functions.mujoco_version,
        "substeps": functions.substeps,
        "episode_length": settings.episode_length,
        "kept": list(functions.kept),
        "read": list(functions.read),
        "qpos": qpos,
        "qvel": qvel,
        **{name: model.SerializeToString() for name, model in translated(functions).items()},
    }


def first_states(functions: StepFunctions, settings: RunSettings) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions and velocities of first states: those of `reskpn evaluate` come first, in its order."""
    key = jax.random.fold_in(jax.random.key(settings.seed), STARTS)
    return functions.first_states(key, FIRST_STATES)


def translated(functions: StepFunctions) -> dict[str, onnx.ModelProto]:
    """The functions of a task as ONNX models; their inputs are named `before.qpos`, `action`, `after.qpos` and on."""
    float32 = jnp.float32
    fields = {name: jax.ShapeDtypeStruct(shape, float32) for name, shape in functions.read.items()}
    before = {f"before.{name}": spec for name, spec in fields.items()}
    after = {f"after.{name}": spec for name, spec in fields.items()}
    action = {"action": jax.ShapeDtypeStruct((functions.action_size,), float32)}
    names, count = list(fields), len(fields)

    def command(*given: jax.Array) -> list[jax.Array]:
        return [functions.command(dict(zip(names, given, strict=False)), given[count])]

    def outcome(*given: jax.Array) -> tuple[jax.Array, ...]:
        at_start, at_end = (dict(zip(names, part, strict=True)) for part in (given[:count], given[count + 1 :]))
        return functions.outcome(at_start, given[count], at_end)

    def first_observation(*given: jax.Array) -> list[jax.Array]:
        return [functions.first_observation(dict(zip(names, given, strict=True)))]

    return {
        "command": to_onnx(command, before | action, ["ctrl"], name="command"),
        "outcome": to_onnx(outcome, before | action | after, ["observation", "reward", "terminated"], name="outcome"),
        "first_observation": to_onnx(first_observation, before, ["observation"], name="first_observation"),
    }
