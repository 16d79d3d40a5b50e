"""The JSON schemas of the messages that Foxglove and Lichtblick draw by the name of their type.

Names and fields are those that Foxglove publishes (docs.foxglove.dev, "Schemas"), where every field is required:
`foxglove.SceneUpdate` and `foxglove.FrameTransforms`. `reskpn.State` is of this project, for plots.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]


def _object(title: str, **properties: Schema) -> Schema:
    return {"title": title, "type": "object", "properties": properties, "required": list(properties)}


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


_NUMBER: Schema = {"type": "number"}
_INTEGER: Schema = {"type": "integer"}
_STRING: Schema = {"type": "string"}
_BOOLEAN: Schema = {"type": "boolean"}

_TIME = _object("time", sec={"type": "integer", "minimum": 0}, nsec={"type": "integer", "minimum": 0})
_DURATION = _object("duration", sec=_INTEGER, nsec={"type": "integer", "minimum": 0})
_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POINT = _object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COLOUR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)

_CUBE = _object("foxglove.CubePrimitive", pose=_POSE, size=_VECTOR, color=_COLOUR)
_SPHERE = _object("foxglove.SpherePrimitive", pose=_POSE, size=_VECTOR, color=_COLOUR)
_CYLINDER = _object(
    "foxglove.CylinderPrimitive",
    pose=_POSE,
    size=_VECTOR,
    bottom_scale=_NUMBER,
    top_scale=_NUMBER,
    color=_COLOUR,
)
_TRIANGLES = _object(
    "foxglove.TriangleListPrimitive",
    pose=_POSE,
    points=_list(_POINT),
    color=_COLOUR,
    colors=_list(_COLOUR),
    indices=_list({"type": "integer", "minimum": 0}),
)
_UNUSED = {
    name: _list(_object(f"foxglove.{kind}Primitive", pose=_POSE, color=_COLOUR))
    for name, kind in {"arrows": "Arrow", "lines": "Line", "texts": "Text", "models": "Model"}.items()
}
"""Primitives that a scene has none of; their lists are required all the same."""

_ENTITY = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_STRING,
    id=_STRING,
    lifetime=_DURATION,
    frame_locked=_BOOLEAN,
    metadata=_list(_object("foxglove.KeyValuePair", key=_STRING, value=_STRING)),
    cubes=_list(_CUBE),
    spheres=_list(_SPHERE),
    cylinders=_list(_CYLINDER),
    triangles=_list(_TRIANGLES),
    **_UNUSED,
)
_DELETION = _object("foxglove.SceneEntityDeletion", timestamp=_TIME, type=_INTEGER, id=_STRING)
_TRANSFORM = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_STRING,
    child_frame_id=_STRING,
    translation=_VECTOR,
    rotation=_QUATERNION,
)

SCHEMAS: Mapping[str, Schema] = {
    "foxglove.SceneUpdate": _object("foxglove.SceneUpdate", deletions=_list(_DELETION), entities=_list(_ENTITY)),
    "foxglove.FrameTransforms": _object("foxglove.FrameTransforms", transforms=_list(_TRANSFORM)),
    "reskpn.State": _object(
        "reskpn.State",
        step=_INTEGER,
        time_s=_NUMBER,
        qpos=_list(_NUMBER),
        qvel=_list(_NUMBER),
        action=_list(_NUMBER),
        reward=_NUMBER,
        episode_return=_NUMBER,
    ),
}
"""By name."""
