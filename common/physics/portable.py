"""A task as data that MuJoCo alone can simulate: its model, its first states, and functions that the caller brings.

Imports neither JAX nor brax: an exported policy is played with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from common.errors import PhysicsError
from common.physics.mujoco_log import DIVERGED, log_instead_of_printing

Fields = Mapping[str, np.ndarray]
"""Fields of MuJoCo's data by name, float32."""


@dataclass(frozen=True)
class TaskFunctions:
    """The functions of `common.physics.step_functions.StepFunctions`, computed by whatever the caller has."""

    command: Callable[[Fields, np.ndarray], np.ndarray]
    outcome: Callable[[Fields, np.ndarray, Fields], tuple[np.ndarray, float, bool]]
    first_observation: Callable[[Fields], np.ndarray]


@dataclass(frozen=True)
class PortableTask:
    """A task's model in MuJoCo's binary form, and numbers; names as in `StepFunctions`.

    qpos, qvel: [n, nq] and [n, nv], first states.
    """

    model: bytes
    mujoco_version: str
    substeps: int
    episode_length: int
    kept: Sequence[str]
    read: Sequence[str]
    qpos: np.ndarray
    qvel: np.ndarray


def model_bytes(model: mujoco.MjModel) -> bytes:
    """A model in MuJoCo's binary form, which the same version of MuJoCo can read."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


class Simulation:
    """One simulation of a task on MuJoCo, stepped as the native engine steps it: float32 between environment steps."""

    def __init__(self, task: PortableTask, functions: TaskFunctions) -> None:
        """Raises PhysicsError: this version of MuJoCo cannot read the model."""
        log_instead_of_printing()
        self._task = task
        self._functions = functions
        self._model = _load(task)
        self._data = mujoco.MjData(self._model)
        self._fields: Fields = {}
        self._steps = 0

    def reset(self, number: int) -> np.ndarray:
        """Begin an episode in a first state, by its number; the observation [O]."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._task.qpos[number]
        self._data.qvel[:] = self._task.qvel[number]
        mujoco.mj_forward(self._model, self._data)
        self._fields = self._read()
        self._steps = 0
        return self._functions.first_observation(self._fields)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool]:
        """One environment step under an action [A], clipped to [-1, 1].

        Returns the observation [O], the reward, and True where the episode is over: terminated, diverged, or of the
        task's length.
        """
        action = np.clip(np.asarray(action, np.float32), -1.0, 1.0)
        before, ctrl = self._fields, self._functions.command(self._fields, action)
        kept = {name: getattr(self._data, name).astype(np.float32) for name in self._task.kept}
        mujoco.mj_resetData(self._model, self._data)
        for name, value in kept.items():
            getattr(self._data, name)[:] = value
        self._data.ctrl[:] = ctrl
        mujoco.mj_step(self._model, self._data, self._task.substeps)
        self._steps += 1
        self._fields = self._read()
        obs, reward, terminated = self._functions.outcome(before, action, self._fields)
        if any(self._data.warning[warning].number for warning in DIVERGED):
            return obs, 0.0, True
        return obs, reward, terminated or self._steps >= self._task.episode_length

    def _read(self) -> Fields:
        return {name: getattr(self._data, name).astype(np.float32) for name in self._task.read}


def _load(task: PortableTask) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_binary_path("task.mjb", {"task.mjb": task.model})
    except ValueError:
        raise PhysicsError(
            f"the model in this file is of MuJoCo {task.mujoco_version}, and MuJoCo {mujoco.__version__} cannot read "
            f"it; install mujoco=={task.mujoco_version}, or export the policy again with this version"
        ) from None
