"""A take as an MCAP file for Foxglove and Lichtblick: the bodies in 3D, and the state for plots.

| topic | schema | content |
| --- | --- | --- |
| `/scene` | `foxglove.SceneUpdate` | once: the shapes of each body, in the frame of the body |
| `/tf` | `foxglove.FrameTransforms` | each step: where the bodies are |
| `/state` | `reskpn.State` | each step: positions, velocities, action, reward, return up to here |

A file of its own, so that the log of a run does not hold every position twice.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mcap.writer import Writer

from common.errors import SettingsError
from reskpn.viewing.footage import Footage, Take
from reskpn.viewing.foxglove_schemas import SCHEMAS
from reskpn.viewing.scene import Scene

WORLD = "world"
LARGEST_PLANE = 40.0
"""Metres of a plane's side, which may be infinite in MuJoCo."""

TOPICS = {"/scene": "foxglove.SceneUpdate", "/tf": "foxglove.FrameTransforms", "/state": "reskpn.State"}

Json = dict[str, Any]


def write_foxglove(path: Path, footage: Footage, take: Take) -> int:
    """Write a take to `path` and return the number of messages.

    Raises:
        SettingsError: the file cannot be written.
        PhysicsError, LogReadError: as `Scene`.
    """
    scene = Scene(footage, [take])
    try:
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(profile="", library="reskpn")
            channels = {
                topic: writer.register_channel(
                    topic,
                    "json",
                    writer.register_schema(name, "jsonschema", json.dumps(SCHEMAS[name]).encode()),
                )
                for topic, name in TOPICS.items()
            }
            writer.add_metadata("take", {"run": footage.run, "task": footage.task, "take": take.name})
            count = 0
            for topic, t_ns, content in messages(scene, take):
                data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
                writer.add_message(channels[topic], log_time=t_ns, publish_time=t_ns, data=data)
                count += 1
            writer.finish()
    except OSError as error:
        raise SettingsError(f"cannot write {path}: {error.strerror or error}; give another file") from None
    return count


def messages(scene: Scene, take: Take) -> Iterator[tuple[str, int, Json]]:
    """The messages of a take in their order: (topic, nanoseconds since the start, content)."""
    yield "/scene", 0, scene_update(scene.model)
    total = 0.0
    for step in range(take.motion.steps):
        scene.show(take, step)
        t_ns = round(step * take.step_s * 1e9)
        yield "/tf", t_ns, {"transforms": _transforms(scene.model, scene.data, t_ns)}
        yield "/state", t_ns, _state(take, step, total)
        total += float(take.motion.reward[step])


def scene_update(model: Any) -> Json:
    """The shapes of all bodies: an entity for each body that has any, in the body's frame."""
    entities = []
    for body in range(model.nbody):
        shapes: dict[str, list[Json]] = {"cubes": [], "spheres": [], "cylinders": [], "triangles": []}
        first = model.body_geomadr[body]
        for geom in range(first, first + model.body_geomnum[body]):
            for kind, shape in _shapes(model, geom):
                shapes[kind].append(shape)
        if any(shapes.values()):
            entity = {"timestamp": _time(0), "frame_id": _frame(model, body), "id": _frame(model, body)}
            fixed = {"lifetime": _time(0), "frame_locked": True, "metadata": []}
            unused: Json = {"arrows": [], "lines": [], "texts": [], "models": []}
            entities.append(entity | fixed | shapes | unused)
    return {"deletions": [], "entities": entities}


def _state(take: Take, step: int, total: float) -> Json:
    motion = take.motion
    return {
        "step": step,
        "time_s": step * take.step_s,
        "qpos": motion.qpos[step].tolist(),
        "qvel": motion.qvel[step].tolist(),
        "action": motion.action[step].tolist(),
        "reward": float(motion.reward[step]),
        "episode_return": total,
    }


def _transforms(model: Any, data: Any, t_ns: int) -> list[Json]:
    return [
        {
            "timestamp": _time(t_ns),
            "parent_frame_id": WORLD,
            "child_frame_id": _frame(model, body),
            "translation": _vector(data.xpos[body]),
            "rotation": _quaternion(data.xquat[body]),
        }
        for body in range(1, model.nbody)
    ]


def _shapes(model: Any, geom: int) -> Iterator[tuple[str, Json]]:
    """The primitives of a geom, as (field of the entity, primitive). Height fields and distance fields are left out."""
    kinds, size = mujoco.mjtGeom, model.geom_size[geom]
    kind = kinds(int(model.geom_type[geom]))
    pose = {"position": _vector(model.geom_pos[geom]), "orientation": _quaternion(model.geom_quat[geom])}
    common = {"pose": pose, "color": _colour(model, geom)}
    if kind == kinds.mjGEOM_PLANE:
        sides = [min(2 * side, LARGEST_PLANE) if side > 0 else LARGEST_PLANE for side in size[:2]]
        yield "cubes", common | {"size": _vector([*sides, 0.001])}
    elif kind == kinds.mjGEOM_BOX:
        yield "cubes", common | {"size": _vector(2 * size)}
    elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        radii = size if kind == kinds.mjGEOM_ELLIPSOID else [size[0]] * 3
        yield "spheres", common | {"size": _vector(2 * np.asarray(radii))}
    elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
        radius, half = float(size[0]), float(size[1])
        extent = {"size": _vector([2 * radius, 2 * radius, 2 * half]), "bottom_scale": 1.0, "top_scale": 1.0}
        yield "cylinders", common | extent
        for end in (-half, half) if kind == kinds.mjGEOM_CAPSULE else ():
            tip = np.zeros(3)
            mujoco.mju_rotVecQuat(tip, np.array([0.0, 0.0, end]), model.geom_quat[geom])
            at = {"position": _vector(model.geom_pos[geom] + tip), "orientation": pose["orientation"]}
            yield "spheres", common | {"pose": at, "size": _vector([2 * radius] * 3)}
    elif kind == kinds.mjGEOM_MESH:
        yield "triangles", common | _mesh(model, int(model.geom_dataid[geom]))


def _mesh(model: Any, mesh: int) -> Json:
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    return {"points": [_vector(at) for at in vertices], "indices": faces.ravel().tolist(), "colors": []}


def _colour(model: Any, geom: int) -> Json:
    """The colour of a geom; its own wins over its material's, unless it is the default, as in MuJoCo."""
    material, rgba = model.geom_matid[geom], model.geom_rgba[geom]
    if material >= 0 and np.allclose(rgba, [0.5, 0.5, 0.5, 1.0]):
        rgba = model.mat_rgba[material]
    return dict(zip("rgba", (float(value) for value in rgba), strict=True))


def _frame(model: Any, body: int) -> str:
    """The name of a body's frame; bodies without a name have their number."""
    return WORLD if body == 0 else model.body(body).name or f"body-{body}"


def _time(t_ns: int) -> Json:
    return {"sec": t_ns // 10**9, "nsec": t_ns % 10**9}


def _vector(at: Any) -> Json:
    return {axis: float(value) for axis, value in zip("xyz", at, strict=True)}


def _quaternion(wxyz: Any) -> Json:
    w, x, y, z = (float(value) for value in wxyz)
    return {"x": x, "y": y, "z": z, "w": w}
