"""The tasks of `brax.envs`, and the MuJoCo models behind all tasks."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np

from common.errors import SettingsError
from common.physics.libraries import envs, log_instead_of_printing, without_announcements
from common.physics.lookup import load_definition
from common.suggestions import unknown_name
from common.tasks import TASKS

OPTIONS = (
    "timestep", "integrator", "solver", "cone", "iterations", "ls_iterations", "tolerance", "ls_tolerance",
    "impratio", "gravity", "wind", "magnetic", "density", "viscosity", "disableflags", "enableflags",
)  # fmt: skip
"""The options that both of MuJoCo's engines have."""


def load_task(task: str) -> Any:
    """The brax environment of `task`, with the options that it sets for MuJoCo's physics.

    Raises:
        SettingsError: `task` is not one of `common.tasks.TASKS`.
    """
    if task not in TASKS:
        raise SettingsError(unknown_name("task", task, TASKS))
    log_instead_of_printing()
    with without_announcements():
        return envs.get_environment(task, backend="mjx")


def task_model(task: str) -> mujoco.MjModel:
    """The model of any task, as the C engine simulates it: to show it, for example.

    Raises:
        SettingsError: there is no such task, or its class may not be imported here (`common.physics.lookup`).
    """
    return c_model(load_task(task)) if task in TASKS else load_definition(task).model


def step_seconds(task: str) -> float:
    """The simulated seconds of one environment step of any task. Raises as `task_model`."""
    if task not in TASKS:
        return load_definition(task).step_s
    # brax holds it in float32: the shortest number that is the same there is the one that was meant.
    return float(str(np.float32(load_task(task).dt)))


def c_model(environment: Any) -> mujoco.MjModel:
    """The model of a brax `environment` for MuJoCo's C engine, with the options of its JAX model.

    A task may change options in the JAX model alone, after reading its model: humanoid changes solver settings.
    """
    model = copy.copy(environment.sys.mj_model)
    for name in OPTIONS:
        wanted = np.asarray(getattr(environment.sys.opt, name))
        # The JAX model holds float32, so numbers are compared after rounding to it.
        if not np.array_equal(np.asarray(getattr(model.opt, name), wanted.dtype), wanted):
            setattr(model.opt, name, wanted if wanted.ndim else wanted.item())
    return model
