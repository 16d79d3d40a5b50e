"""The arrays of an environment state by path, found from the task's model without an engine."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from common.physics.assets import model_xml
from common.physics.lookup import load_definition
from common.physics.simulation import ReadingLayout
from common.tasks import TASKS, Task

Shapes = dict[str, tuple[str, tuple[int, ...]]]
"""(dtype, shape) by path."""


def state_shapes(task: Task, num_envs: int, randomised: Iterable[str] = ()) -> Shapes:
    """The dtype and shape of every array of an `EnvState` of N environments, by its path; the same for both engines.

    `randomised`: names of the factors that each environment has.

    Raises:
        PhysicsError: the package that has the model is not installed.
        SettingsError: the task's class may not be imported here, or is not a task's.
    """
    fields = _brax_fields(task.name) if task.name in TASKS else _own_fields(task.name)
    fields |= {f"scales/{name}": () for name in randomised}
    observation = (task.observation_size,)
    floats = {f"{where}/{field}": shape for where in ("bodies", "first_bodies") for field, shape in fields.items()}
    floats |= {"obs": observation, "first_obs": observation, "episode_return": ()}
    ints: dict[str, tuple[int, ...]] = {"steps": (), "diverged": ()}
    return {path: ("float32", (num_envs, *shape)) for path, shape in floats.items()} | {
        path: ("int32", (num_envs, *shape)) for path, shape in ints.items()
    }


def _brax_fields(name: str) -> dict[str, tuple[int, ...]]:
    model = mujoco.MjModel.from_xml_string(model_xml(name))
    # brax fuses bodies that have no joint with their parents, the world among them.
    bodies = int(np.count_nonzero(model.body_jntnum[1:]))
    return {
        "q": (model.nq,),
        "qd": (model.nv,),
        "x/pos": (bodies, 3),
        "x/rot": (bodies, 4),
        "xd/ang": (bodies, 3),
        "xd/vel": (bodies, 3),
        "warmstart": (model.nv,),
    }


def _own_fields(name: str) -> dict[str, tuple[int, ...]]:
    task = load_definition(name)
    layout = ReadingLayout(task.model, task.reads)
    return {"q": (task.model.nq,), "qd": (task.model.nv,), "warmstart": (task.model.nv,)} | layout.rest()
