"""The shape of the source tree: its folders, who may import whom, and what is never imported."""

from __future__ import annotations

import ast
import functools
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


def test_test_modules_have_names_of_their_own() -> None:
    """pytest imports them by their file's name alone: of two with one name, the one that comes second is an error."""
    packaged = {path.parent for path in (ROOT / "tests").rglob("__init__.py")}
    paths = [path for path in (ROOT / "tests").rglob("test_*.py") if path.parent not in packaged]
    alike = [path for path in paths if sum(other.name == path.name for other in paths) > 1]
    assert not alike


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


PRODUCT = ("common", "reskpn", "services")
LONGEST_FILE = 300
LONGEST_FUNCTION = 60


@functools.cache
def product_modules() -> tuple[tuple[str, str, ast.Module], ...]:
    """Path, text and syntax tree of every module that is installed."""
    paths = [path for folder in PRODUCT for path in sorted((ROOT / folder).rglob("*.py"))]
    texts = [path.read_text("utf-8") for path in paths]
    return tuple((str(path.relative_to(ROOT)), text, ast.parse(text)) for path, text in zip(paths, texts, strict=True))


def test_files_and_functions_are_of_a_size_that_a_reader_can_hold() -> None:
    """At most 300 lines a file, 60 a function."""
    long_files = [path for path, text, _ in product_modules() if text.count("\n") > LONGEST_FILE]
    long_functions = [
        f"{path}:{node.lineno} {node.name}"
        for path, _, tree in product_modules()
        for node in ast.walk(tree)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        and (node.end_lineno or node.lineno) - node.lineno + 1 > LONGEST_FUNCTION
    ]
    assert not long_files
    assert not long_functions


def test_docstrings_open_with_what_the_thing_returns_or_does() -> None:
    """An imperative or a noun phrase: no question words."""
    question_words = {"What", "Whether", "Who", "Whose", "How", "Why"}
    found = [
        f"{path}:{getattr(node, 'lineno', 1)}: {docstring.splitlines()[0]}"
        for path, _, tree in product_modules()
        for node in ast.walk(tree)
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        and (docstring := ast.get_docstring(node)) is not None
        and docstring.split(maxsplit=1)[0].strip(",.:") in question_words
    ]
    assert not found, "\n".join(found)


def rooms_of_services() -> dict[str, set[str]]:
    """Imports between the rooms of `services/`; inside the learner each folder or file is a room of its own."""

    def room(module: str) -> str:
        parts = module.split(".")
        return ".".join(parts[: 3 if parts[1] == "learner" else 2])

    imports: dict[str, set[str]] = {}
    for path, _, tree in product_modules():
        module = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        if not module.startswith("services.") or module in ("services.learner",):
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("services."):
                found = imports.setdefault(room(module), set())
                found |= {room(node.module or "")} - {room(module)}
    return imports


def test_services_are_a_few_rooms_on_a_few_floors_without_a_circle() -> None:
    """At most 14 rooms at the first two levels, at most 6 levels of imports, no circle."""
    imports = rooms_of_services()
    rooms = set(imports) | {imported for found in imports.values() for imported in found}

    def floor(room: str, above: tuple[str, ...] = ()) -> int:
        assert room not in above, f"a circle of imports: {' -> '.join((*above, room))}"
        return 1 + max((floor(imported, (*above, room)) for imported in imports.get(room, ())), default=0)

    assert len(rooms) <= 14, sorted(rooms)
    assert max(map(floor, rooms)) <= 6
