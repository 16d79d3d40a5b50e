"""A task's MJCF with the files it refers to, and the sources of its class."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from common.errors import SettingsError
from common.physics.task import Task

PACKAGES = ("common", "reskpn", "services")
"""Top-level packages of this project, whose sources a digest leaves out: the log has their version."""


@dataclass(frozen=True)
class Mjcf:
    """The text of a model, the folder that its files are relative to, and the files it names by name."""

    text: str
    path: Path | None
    files: dict[str, bytes]


def read_mjcf(name: str, task: Task) -> Mjcf:
    """The MJCF of a task. SettingsError where a file cannot be read."""
    if isinstance(task.mjcf, str) and "<" in task.mjcf:
        return Mjcf(task.mjcf, None, _files(name, task.mjcf, _folder(task)))
    path = _folder(task) / task.mjcf
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"task {name}: its MJCF {path} cannot be read ({error})") from None
    return Mjcf(text, path, _files(name, text, path.parent))


def spec_of(name: str, mjcf: Mjcf) -> mujoco.MjSpec:
    """The model before it is compiled. SettingsError where MuJoCo refuses it."""
    try:
        return mujoco.MjSpec.from_string(mjcf.text) if mjcf.path is None else mujoco.MjSpec.from_file(str(mjcf.path))
    except ValueError as error:
        raise SettingsError(f"task {name}: its MJCF does not load: {' '.join(str(error).split())}") from None


def sources_of(task: Task) -> dict[str, bytes]:
    """The source files of a task's class, and of the classes that it is derived from, by file name."""
    modules = {cls.__module__ for cls in type(task).__mro__}
    own = sorted(module for module in modules if module.split(".")[0] not in (*PACKAGES, "abc", "builtins"))
    found = {}
    for module in own:
        path = inspect.getsourcefile(sys.modules[module])
        if path is not None:
            found[f"{module}.py"] = Path(path).read_bytes().replace(b"\r\n", b"\n")
    return found


def _folder(task: Task) -> Path:
    """The folder of the source file of the class."""
    path = sys.modules[type(task).__module__].__file__
    return Path.cwd() if path is None else Path(path).parent


def _files(name: str, text: str, folder: Path) -> dict[str, bytes]:
    """The files that an MJCF names: included models, meshes, textures."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise SettingsError(f"task {name}: its MJCF does not load: it is not XML ({error})") from None
    folders = [
        folder, *(folder / value for compiler in root.iter("compiler") for key in ("assetdir", "meshdir", "texturedir")
        if (value := compiler.get(key)))
    ]  # fmt: skip
    found: dict[str, bytes] = {}
    for file in _named(root):
        path = next((place / file for place in folders if (place / file).is_file()), None)
        if path is None:
            continue  # MuJoCo says so, with the place in the MJCF
        found[file] = path.read_bytes()
        if path.suffix == ".xml":
            found |= _files(name, found[file].decode("utf-8", "replace"), folder)
    return found


def _named(root: ElementTree.Element) -> Iterator[str]:
    """The values of all `file` attributes, each once."""
    yield from dict.fromkeys(value for element in root.iter() if (value := element.get("file")))
