"""The shape of the source tree: its folders, who may import whom, and what is never imported."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("benchmarks", "common", "docs", "requirements", "reskpn", "scripts", "services", "tests")

UNPICKLERS = frozenset({"pickle", "_pickle", "cPickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"})


def source_files() -> Iterator[Path]:
    """Every Python file of the tree."""
    for folder in FOLDERS:
        yield from sorted((ROOT / folder).rglob("*.py"))


def unpickling(source: str) -> list[str]:
    """What of a module could unpickle: imports by statement or by call, and `allow_pickle` that is not False."""
    found = []
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__"):
            names = [word.value for word in node.args if isinstance(word, ast.Constant) and isinstance(word.value, str)]
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            allowed = not (isinstance(node.value, ast.Constant) and node.value.value is False)
            found += ["allow_pickle"] if allowed else []
        found += [name for name in names if name.split(".")[0] in UNPICKLERS]
    return found


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_folders_that_tell_the_architecture(folder: str) -> None:
    """Are there, with something in them."""
    assert any(path.is_file() for path in (ROOT / folder).rglob("*"))


def test_who_may_import_whom() -> None:
    """Every contract of pyproject.toml is kept."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    assert contracts
    # In a process of its own, since it disables the loggers that are there.
    program = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True, no_logo=True))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"Contracts: {len(contracts)} kept, 0 broken." in done.stdout


def test_nothing_is_ever_unpickled() -> None:
    """No module can: bytes from the network, a log or a checkpoint must not run code."""
    found = {
        str(path.relative_to(ROOT)): names for path in source_files() if (names := unpickling(path.read_text("utf-8")))
    }
    assert not found


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "import numpy, dill as d",
        "from pickle import loads",
        "def f():\n    from cloudpickle.x import y",
        "importlib.import_module('pickle')",
        "__import__('_pickle')",
        "np.load(file, allow_pickle=True)",
        "np.load(file, allow_pickle=flag)",
    ],
)
def test_ways_to_unpickle_are_found(source: str) -> None:
    """The test above can fail."""
    assert unpickling(source)


def test_what_does_not_unpickle_is_left_alone() -> None:
    """Words in texts, and NumPy told not to."""
    assert not unpickling("import json\ntext = 'import pickle'\nnp.load(file, allow_pickle=False)\n")
