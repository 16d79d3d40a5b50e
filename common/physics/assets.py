"""The tasks' MJCF files, found without importing an engine; every log contains its task's model."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from common.errors import PhysicsError

_FILES = {"halfcheetah": "half_cheetah"}
"""Tasks whose file in brax has a different name."""


def model_xml(task: str) -> str:
    """The MJCF of a task as shipped with brax. Raises PhysicsError if brax is not installed."""
    spec = importlib.util.find_spec("brax")
    if spec is None or not spec.submodule_search_locations:
        raise PhysicsError("brax is not installed: its models are needed; run `make setup`")
    path = Path(spec.submodule_search_locations[0]) / "envs" / "assets" / f"{_FILES.get(task, task)}.xml"
    return path.read_text()
