"""Parts of a model that MJX accepts without a word and simulates otherwise than MuJoCo.

Found with mujoco 4.0.0 and mujoco-mjx 3.17.0; findings/mjx-*.sh show most of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from common.physics.models import task_model

_IMPLICIT = (int(mujoco.mjtIntegrator.mjINT_IMPLICIT), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))
_WRAPPED = (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER))


def mjx_differences(model: mujoco.MjModel) -> list[str]:
    """A sentence for each part of the model that MJX would compute otherwise; empty where none is known."""
    return [sentence for find in _CHECKS for sentence in find(model)]


def differences_of(task: str) -> list[str]:
    """The sentences for a task by name."""
    return mjx_differences(task_model(task))


def _limited_joints(model: mujoco.MjModel) -> Iterator[str]:
    """Joints whose actuator forces are limited, with an implicit integrator."""
    if int(model.opt.integrator) not in _IMPLICIT or not model.nu:
        return
    names = [model.joint(joint).name or str(joint) for joint in np.flatnonzero(model.jnt_actfrclimited)]
    if names:
        yield (
            f"joint {_listed(names)}: at actuatorfrcrange with an implicit integrator, MJX damps the joint by "
            'an actuator that is at its limit, and moves it less far; integrator="Euler" is the same in both'
        )


def _side_sites(model: mujoco.MjModel) -> Iterator[str]:
    """Tendons that wrap around a geom on the side of a site."""
    names = []
    for tendon in range(model.ntendon):
        first = model.tendon_adr[tendon]
        wraps = range(first, first + model.tendon_num[tendon])
        if any(model.wrap_type[wrap] in _WRAPPED and model.wrap_prm[wrap] >= 0 for wrap in wraps):
            names.append(model.tendon(tendon).name or str(tendon))
    if names:
        yield f"tendon {_listed(names)}: with a sidesite, MJX may take another path around the geom"


def _yielding_springs(model: mujoco.MjModel) -> Iterator[str]:
    """Springs that yield."""
    joints = [model.joint(joint).name or str(joint) for joint in np.flatnonzero(model.jnt_springyield > 0)]
    tendons = [model.tendon(tendon).name or str(tendon) for tendon in np.flatnonzero(model.tendon_springyield > 0)]
    for kind, names in (("joint", joints), ("tendon", tendons)):
        if names:
            yield f"{kind} {_listed(names)}: a spring that yields (springyield) stays elastic in MJX"
    if np.any(model.flex_plasticmode):
        yield "a flex that yields stays elastic in MJX"


def _runge_kutta(model: mujoco.MjModel) -> Iterator[str]:
    """Free joints integrated by RK4."""
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    if int(model.opt.integrator) == int(mujoco.mjtIntegrator.mjINT_RK4) and free.size:
        names = [model.joint(joint).name or model.body(model.jnt_bodyid[joint]).name or str(joint) for joint in free]
        yield f"free joint {_listed(names)}: with integrator RK4, MJX is of second order only; take half the timestep"


def _static_accelerometers(model: mujoco.MjModel) -> Iterator[str]:
    """Accelerometers on bodies that cannot move."""
    found = []
    for sensor in np.flatnonzero(model.sensor_type == int(mujoco.mjtSensor.mjSENS_ACCELEROMETER)):
        body = model.site_bodyid[model.sensor_objid[sensor]]
        if model.body_weldid[body] == 0:
            found.append(model.sensor(sensor).name or str(sensor))
    if found:
        yield f"accelerometer {_listed(found)}: on a body without joints, MJX measures 0 where MuJoCo measures gravity"


_CHECKS = (_limited_joints, _side_sites, _yielding_springs, _runge_kutta, _static_accelerometers)


def _listed(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
