"""The model of a task as it is shown: its state set from a trajectory, and the view of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import mujoco
import numpy as np

from common.errors import LogReadError, PhysicsError, SettingsError
from common.physics.mujoco_log import log_instead_of_printing
from reskpn.viewing.footage import Footage, Take

AUTO = "auto"

FIELD_OF_VIEW = 45.0


@dataclass(frozen=True)
class Shot:
    """A view: degrees of azimuth and elevation, metres of distance and of the height that is looked at.

    `follows`: the view moves with the robot over the floor. Its height stays, so that a jump is seen as one.
    """

    azimuth: float
    elevation: float
    distance: float
    height: float
    follows: bool = True


SHOTS = {
    "hopper": Shot(90, -10, 3.6, 0.75),
    "walker2d": Shot(90, -10, 4.0, 0.8),
    "halfcheetah": Shot(90, -12, 3.8, 0.4),
    "humanoid": Shot(125, -12, 4.6, 0.95),
    "humanoidstandup": Shot(125, -15, 4.4, 0.6),
    "inverted_pendulum": Shot(90, -8, 2.8, 0.25, follows=False),
    "pusher": Shot(150, -35, 2.6, -0.2, follows=False),
    "reacher": Shot(90, -65, 0.75, 0.0, follows=False),
}
"""The best views of the tasks that have one; every other task is shown by `_shot_of`."""


class Scene:
    """A compiled model and the state that is shown, at first that of the first take.

    Attributes:
        shot: the task's view.

    Raises:
        PhysicsError: MuJoCo does not load the model.
        LogReadError: the trajectories are of another model.
    """

    def __init__(self, footage: Footage, takes: list[Take]) -> None:
        log_instead_of_printing()
        try:
            # MuJoCo looks for the files of a model by their bare names.
            files = {PurePosixPath(name).name: data for name, data in footage.files.items()}
            self.model: Any = mujoco.MjModel.from_xml_string(footage.mjcf, files)
        except ValueError as error:
            raise PhysicsError(f"MuJoCo does not load the model of {footage.task} in the log: {error}") from None
        self.task = footage.task
        self.data: Any = mujoco.MjData(self.model)
        for take in takes:
            given = take.motion.qpos.shape[1], take.motion.qvel.shape[1]
            if given != (self.model.nq, self.model.nv):
                raise LogReadError(
                    f"{footage.path}: {take.name} has {given[0]} positions and {given[1]} velocities, but the model in "
                    f"the log has {self.model.nq} and {self.model.nv}"
                )
        self.show(takes[0], 0)
        self.shot = SHOTS.get(self.task) or self._shot_of()

    def show(self, take: Take, step: int) -> None:
        """Set the state before a step of the take."""
        self.data.qpos[:] = take.motion.qpos[step]
        self.data.qvel[:] = take.motion.qvel[step]
        self.data.time = step * take.step_s
        mujoco.mj_forward(self.model, self.data)

    def camera(self, name: str = AUTO) -> Any:
        """The view called `name`: a camera of the model, or "auto" for the task's own.

        Raises:
            SettingsError: the model has no such camera.
        """
        if name == AUTO:
            return self._free_camera()
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if number < 0:
            names = [self.model.camera(n).name for n in range(self.model.ncam)]
            known = ", ".join([AUTO, *(found for found in names if found)])
            raise SettingsError(f"--camera is {name!r}; the model has {known}")
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = number
        return camera

    def follow(self, camera: Any) -> None:
        """Move a view of `camera` with the robot, where the task's view does that, and the sun with it."""
        if camera.type != mujoco.mjtCamera.mjCAMERA_FREE or not self.shot.follows:
            return
        centre = self._centre()[:2]
        camera.lookat[:2] = centre
        # A light from afar casts shadows only near its own place.
        for light in range(self.model.nlight):
            if self.model.light_type[light] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
                self.data.light_xpos[light][:2] = centre

    def _free_camera(self) -> Any:
        shot, camera = self.shot, mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.azimuth, camera.elevation, camera.distance = shot.azimuth, shot.elevation, shot.distance
        camera.lookat[:] = [0.0, 0.0, shot.height]
        if not shot.follows and self.task not in SHOTS:
            camera.lookat[:2] = self._centre()[:2]
        return camera

    def _centre(self) -> np.ndarray:
        """The centre of mass of all that moves."""
        return np.array(self.data.subtree_com[0])

    def _shot_of(self) -> Shot:
        """A view that has the whole model in it, without its planes; it follows what can move over the floor."""
        placed = [n for n in range(self.model.ngeom) if self.model.geom_type[n] != mujoco.mjtGeom.mjGEOM_PLANE]
        if not placed:
            return Shot(135, -20, 3.0, 0.5, follows=False)
        at, radius = self.data.geom_xpos[placed], self.model.geom_rbound[placed]
        middle = (at.min(axis=0) + at.max(axis=0)) / 2
        extent = float(np.max(np.linalg.norm(at - middle, axis=1) + radius))
        sliding = [int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
        follows = bool(np.isin(self.model.jnt_type, sliding).any())
        return Shot(120, -15, 3.2 * extent, float(middle[2]), follows)
