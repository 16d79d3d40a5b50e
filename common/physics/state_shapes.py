"""The arrays of an environment state by path, found from the task's model without an engine."""

from __future__ import annotations

import mujoco
import numpy as np

from common.physics.assets import model_xml
from common.tasks import TASKS

Shapes = dict[str, tuple[str, tuple[int, ...]]]
"""(dtype, shape) by path."""


def state_shapes(task: str, num_envs: int) -> Shapes:
    """The dtype and shape of every array of an `EnvState` of N environments, by its path; the same for both engines.

    Raises PhysicsError if brax, which has the models, is not installed.
    """
    model = mujoco.MjModel.from_xml_string(model_xml(task))
    # brax fuses bodies that have no joint with their parents, the world among them.
    bodies = int(np.count_nonzero(model.body_jntnum[1:]))
    body = {
        "q": (model.nq,),
        "qd": (model.nv,),
        "x/pos": (bodies, 3),
        "x/rot": (bodies, 4),
        "xd/ang": (bodies, 3),
        "xd/vel": (bodies, 3),
        "warmstart": (model.nv,),
    }
    observation = (TASKS[task].observation_size,)
    floats = {f"{where}/{field}": shape for where in ("bodies", "first_bodies") for field, shape in body.items()}
    floats |= {"obs": observation, "first_obs": observation, "episode_return": ()}
    ints: dict[str, tuple[int, ...]] = {"steps": (), "diverged": ()}
    return {path: ("float32", (num_envs, *shape)) for path, shape in floats.items()} | {
        path: ("int32", (num_envs, *shape)) for path, shape in ints.items()
    }
