"""The wheel has one top-level package: `common` and `services` are installed as `reskpn.common` and `reskpn.services`.

docs/decisions/0041-one-package-in-the-wheel.md has the reasons. All else is in pyproject.toml.
"""

from __future__ import annotations

import ast
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

PACKAGE = "reskpn"
NESTED = ("common", "services")


def nested(source: str) -> str:
    """The source of a module with its imports of nested packages by their installed names.

    Only names after `from` are changed: line numbers stay, and nothing else of a module can be meant by accident.

    Raises:
        ValueError: `import common.x` binds the name `common`, which is not that of the installed package.
    """
    lines = source.splitlines(keepends=True)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import) and any(alias.name.split(".")[0] in NESTED for alias in node.names):
            raise ValueError(f"line {node.lineno}: write `from {node.names[0].name} import ...`")
        if isinstance(node, ast.ImportFrom) and not node.level and (node.module or "").split(".")[0] in NESTED:
            line = lines[node.lineno - 1]
            at = len(line.encode()[: node.col_offset].decode())
            assert line[at:].startswith(f"from {node.module} "), line
            lines[node.lineno - 1] = f"{line[:at]}from {PACKAGE}.{line[at + len('from ') :]}"
    return "".join(lines)


class BuildOnePackage(build_py):
    """Builds the packages as they are, then moves those of `NESTED` into `PACKAGE`."""

    def run(self) -> None:
        top = Path(self.build_lib)
        if not self.editable_mode:
            for name in (PACKAGE, *NESTED):  # a module that was deleted since the last build must not be left
                shutil.rmtree(top / name, ignore_errors=True)
        super().run()
        if self.editable_mode:
            return
        for name in NESTED:
            (top / name).rename(top / PACKAGE / name)
        for path in (top / PACKAGE).rglob("*.py"):
            try:
                path.write_text(nested(path.read_text("utf-8")), "utf-8")
            except ValueError as error:
                raise SystemExit(f"{path.relative_to(top)}, {error}") from None


class WheelOfOnePackage(bdist_wheel):
    """Says in the metadata, too, that there is one top-level package."""

    def write_wheelfile(self, wheelfile_base: str, *rest: str) -> None:
        super().write_wheelfile(wheelfile_base, *rest)
        (Path(wheelfile_base) / "top_level.txt").write_text(f"{PACKAGE}\n")


setup(cmdclass={"build_py": BuildOnePackage, "bdist_wheel": WheelOfOnePackage})
