"""Runs side by side: which of them differ in their seed alone, and what the others differ in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from common.errors import SettingsError
from reskpn.study.groups import Group, refuse_mixed_versions
from reskpn.study.recorded import read_run, result_of
from reskpn.study.results import Result, read_result, settings_of

NOT_COMPARED = ("task", "seed", "total_steps", "rkhs.variance_every", "actors", "physics")


def load_results(paths: Sequence[Path]) -> list[Result]:
    """The results of run directories, result files and folders of result files.

    Raises:
        LogReadError: one is none of these, or damaged.
        SettingsError: a path does not exist, or nothing was found.
    """
    found: list[Result] = []
    for path in paths:
        if not path.exists():
            raise SettingsError(f"{path} does not exist; give run directories, result files or folders of them")
        if path.is_file() and path.suffix == ".json":
            found.append(read_result(path))
        elif path.is_file() or (path / "log").is_dir() or any(path.glob("*.mcap")):
            found.append(result_of(read_run(path)))
        else:
            found += [read_result(file) for file in sorted(path.rglob("*.json"))]
    if not found:
        raise SettingsError("no runs in what was given; give run directories, result files or folders of them")
    return found


def compare(results: Sequence[Result]) -> list[Group]:
    """Groups of the runs that differ in seed and task alone, named by the settings in which groups differ.

    Raises:
        SettingsError: they were made with different versions of what computes them.
    """
    trees = [_leaves(settings_of(result).model_dump(mode="json")) for result in results]
    names = [name for name in dict.fromkeys(n for tree in trees for n in tree) if name not in NOT_COMPARED]
    differing = [name for name in names if len({str(tree.get(name)) for tree in trees}) > 1 and name != "learner"]
    groups: dict[str, dict[str, list[Result]]] = {}
    for result, tree in zip(results, trees, strict=True):
        label = ", ".join([result.learner, *(f"{name}={_short(tree.get(name))}" for name in differing)])
        groups.setdefault(label, {}).setdefault(result.task, []).append(result)
    made = [Group(label, label, by_task) for label, by_task in groups.items()]
    refuse_mixed_versions(made, "these runs")
    return made


APART = ("transport", "log", "evaluation", "device_memory")
"""Sections that do not decide what a run learns."""


def _leaves(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Settings that decide what a run learns, by dotted name."""
    leaves: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            leaves |= _leaves(value, f"{prefix}{name}.") if name not in APART else {}
        elif name not in ("run_dir", "slot_wait_s"):
            leaves[prefix + name] = value
    return leaves


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
