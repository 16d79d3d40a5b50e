"""The file for Foxglove: its schemas, and that what is in it is where the robot was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from logs import STEP_S, usual_log
from mcap.reader import make_reader

from common.errors import SettingsError
from reskpn.viewing.footage import Footage, choose, read_footage
from reskpn.viewing.foxglove import write_foxglove

PRIMITIVE = {"pose", "size", "color"}
PUBLISHED = {
    "foxglove.SceneUpdate": {"deletions", "entities"},
    "foxglove.SceneEntity": {
        "timestamp", "frame_id", "id", "lifetime", "frame_locked", "metadata", "arrows", "cubes", "spheres",
        "cylinders", "lines", "triangles", "texts", "models",
    },
    "foxglove.CubePrimitive": PRIMITIVE,
    "foxglove.SpherePrimitive": PRIMITIVE,
    "foxglove.CylinderPrimitive": PRIMITIVE | {"bottom_scale", "top_scale"},
    "foxglove.TriangleListPrimitive": {"pose", "points", "color", "colors", "indices"},
    "foxglove.Pose": {"position", "orientation"},
    "foxglove.Vector3": {"x", "y", "z"},
    "foxglove.Quaternion": {"x", "y", "z", "w"},
    "foxglove.Color": {"r", "g", "b", "a"},
    "foxglove.FrameTransforms": {"transforms"},
    "foxglove.FrameTransform": {"timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation"},
}  # fmt: skip
"""Fields by schema, all required, as published in foxglove/foxglove-sdk, schemas/jsonschema (read 2026-11-28)."""


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Footage:
    return read_footage(usual_log(tmp_path_factory.mktemp("run")))


def written(footage: Footage, path: Path) -> list[tuple[str, int, Any, Any]]:
    """(topic, nanoseconds, content, schema) of every message of version 0, which has 30 steps."""
    write_foxglove(path, footage, choose(footage, version=0, episode=0, diverged=False))
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, json.loads(message.data), json.loads(schema.data))
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages()
            if schema is not None
        ]


def objects(schema: Any) -> list[Any]:
    """All object schemas inside of a schema."""
    inner = [*schema.get("properties", {}).values(), *([schema["items"]] if "items" in schema else [])]
    return [schema] * (schema.get("type") == "object") + [found for part in inner for found in objects(part)]


def test_messages_are_of_their_schemas_and_those_of_foxglove(footage: Footage, tmp_path: Path) -> None:
    """Every message fits the schema in the file; every schema of Foxglove's has the published fields, all required."""
    found = written(footage, tmp_path / "take.mcap")
    assert [topic for topic, *_ in found].count("/tf") == 30
    assert [topic for topic, *_ in found].count("/state") == 30
    for _, _, content, schema in found:
        jsonschema.validate(content, schema)
    for schema in [part for _, _, _, whole in found for part in objects(whole)]:
        if schema["title"] in PUBLISHED:
            assert set(schema["properties"]) == set(schema["required"]) == PUBLISHED[schema["title"]]


def test_the_shapes_of_the_model(footage: Footage, tmp_path: Path) -> None:
    """A floor; a box of 0.4 x 0.2 x 0.2 m; a capsule of 0.6 m: a cylinder with a sphere at each end; a knob."""
    (scene,) = [content for topic, _, content, _ in written(footage, tmp_path / "take.mcap") if topic == "/scene"]
    entities = {entity["frame_id"]: entity for entity in scene["entities"]}
    assert set(entities) == {"world", "cart", "pole"}
    assert entities["world"]["cubes"][0]["size"] == {"x": 10.0, "y": 10.0, "z": 0.001}
    (box,) = entities["cart"]["cubes"]
    assert box["size"] == {"x": 0.4, "y": 0.2, "z": 0.2}
    assert box["color"] == pytest.approx({"r": 0.9, "g": 0.1, "b": 0.1, "a": 1.0})
    (rod,) = entities["pole"]["cylinders"]
    assert rod["size"] == pytest.approx({"x": 0.08, "y": 0.08, "z": 0.6})
    heights = sorted(sphere["pose"]["position"]["z"] for sphere in entities["pole"]["spheres"])
    assert heights == pytest.approx([0.0, 0.6, 0.6])


def test_bodies_are_where_the_joints_put_them(footage: Footage, tmp_path: Path) -> None:
    """At step n the cart is at 0.01 n and 0.3 m high, and the pole is turned by 0.02 n about y."""
    found = written(footage, tmp_path / "take.mcap")
    moved = [content for topic, _, content, _ in found if topic == "/tf"]
    times = [t_ns for topic, t_ns, *_ in found if topic == "/tf"]
    frames = {one["child_frame_id"]: one for one in moved[20]["transforms"]}
    assert frames["cart"]["translation"] == pytest.approx({"x": 0.2, "y": 0.0, "z": 0.3})
    assert frames["pole"]["rotation"] == pytest.approx({"x": 0.0, "y": np.sin(0.2), "z": 0.0, "w": np.cos(0.2)})
    assert times[20] == round(20 * STEP_S * 1e9)
    states = [content for topic, _, content, _ in found if topic == "/state"]
    # rewards are 0, 1, 2, ...: 0 + 1 + 2 before step 3
    assert (states[3]["reward"], states[3]["episode_return"], states[3]["qvel"]) == (3.0, 3.0, [0.25, 0.5])


def test_a_file_that_cannot_be_written(footage: Footage, tmp_path: Path) -> None:
    """One sentence."""
    with pytest.raises(SettingsError, match=r"cannot write .*: No such file or directory; give another file"):
        written(footage, tmp_path / "missing" / "take.mcap")
