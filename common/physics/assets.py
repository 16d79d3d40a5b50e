"""The tasks' MJCF files, found without importing an engine; every log contains its task's model."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from common.errors import PhysicsError
from common.tasks import TASKS, slug

_FILES = {"halfcheetah": "half_cheetah"}
"""Tasks whose file in brax has a different name."""

Files = dict[str, bytes]


def model_xml(task: str) -> str:
    """The MJCF of a task: as shipped with brax or Gymnasium, or that of the class.

    Raises:
        PhysicsError: the package with the model is not installed.
        SettingsError: the class may not be imported here, or has no MJCF that loads.
    """
    if task not in TASKS:
        from common.physics.lookup import load_definition
        from common.physics.mjcf import read_mjcf

        return read_mjcf(task, load_definition(task)).text
    spec = importlib.util.find_spec("brax")
    if spec is None or not spec.submodule_search_locations:
        raise PhysicsError("brax is not installed: its models are needed; run `make setup`")
    path = Path(spec.submodule_search_locations[0]) / "envs" / "assets" / f"{_FILES.get(task, task)}.xml"
    return path.read_text()


def task_files(task: str) -> Files:
    """The files of a task that its log contains, by name: the MJCF, what it refers to, and the source of the class.

    Raises as `model_xml`.
    """
    files = {f"{slug(task)}.xml": model_xml(task).encode()}
    if task in TASKS:
        return files
    from common.physics.lookup import load_definition
    from common.physics.mjcf import read_mjcf, sources_of

    definition = load_definition(task)
    return files | read_mjcf(task, definition).files | sources_of(definition)
