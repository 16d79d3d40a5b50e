"""The runs of a folder: what each is, how far it came, and whether it is running."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from common.log.lock import LOCK
from common.log.segments import LOG_DIRECTORY, list_segments, segment_number
from common.runs.directory import CHECKPOINTS, SETTINGS, SUMMARY

LOCKS = Path("/proc/locks")

State = Literal["finished", "running", "stopped", "starting"]


@dataclass(frozen=True)
class ListedRun:
    """A run as its directory shows it, without reading its log.

    Attributes:
        env_steps: steps made; of a run without a summary those up to its newest checkpoint; None if not known.
        episode_return: of the final evaluation, or else of the training; None if not known.
        state: "stopped" runs can be resumed; "starting" ones have no settings yet.
        modified_s: Unix time of the last change that is seen without reading the log.
    """

    path: Path
    task: str
    learner: str
    seed: int | None
    env_steps: int | None
    total_steps: int | None
    episode_return: float | None
    state: State
    size_bytes: int
    modified_s: float


def list_runs(folder: Path) -> list[ListedRun]:
    """The runs in a folder, the newest first; none where there is no such folder. OSError where it cannot be read."""
    locked = _locked_inodes()
    try:
        paths = [path for path in folder.iterdir() if path.is_dir() and not path.is_symlink()]
    except FileNotFoundError:
        return []
    found = [listed for path in paths if (listed := _listed(path, locked)) is not None]
    return sorted(found, key=lambda listed: (listed.modified_s, listed.path.name), reverse=True)


def describe_run(path: Path) -> ListedRun | None:
    """The run in a directory; None if it holds none."""
    return _listed(path, _locked_inodes())


def newest_run(folder: Path) -> Path | None:
    """The directory of the newest run in a folder, also of one that is just starting; None if none can be seen."""
    try:
        runs = list_runs(folder)
    except OSError:
        return None
    return runs[0].path if runs else None


def read_summary(run_dir: Path) -> dict[str, Any] | None:
    """The summary of a run; None if there is none."""
    return _read_object(run_dir / SUMMARY)


def _listed(path: Path, locked: frozenset[int]) -> ListedRun | None:
    try:
        names = {entry.name for entry in path.iterdir()}
        settings = _read_object(path / SETTINGS) or {}
        # Other programs have files of these names, too.
        if names and not {"task", "learner"} <= settings.keys() and not list_segments(path / LOG_DIRECTORY):
            return None
        size, modified_s = _size(path), _modified_s(path, names)
    except OSError:
        return None
    summary = read_summary(path)
    return ListedRun(
        path=path,
        task=str(settings.get("task", "-")),
        learner=str(settings.get("learner", "-")),
        seed=_integer(settings.get("seed")),
        env_steps=_integer((summary or {}).get("total_steps")) if summary else _checkpointed_steps(path, settings),
        total_steps=_integer(settings.get("total_steps")),
        episode_return=_return(summary or {}),
        state=_state(path, names, summary, locked),
        size_bytes=size,
        modified_s=modified_s,
    )


def _state(path: Path, names: set[str], summary: dict[str, Any] | None, locked: frozenset[int]) -> State:
    try:
        if (path / LOG_DIRECTORY / LOCK).stat().st_ino in locked:
            return "running"
    except OSError:
        pass  # no lock: nothing has written a log here
    if summary is not None and summary.get("complete") is True:
        return "finished"
    return "stopped" if SETTINGS in names else "starting"


def _locked_inodes() -> frozenset[int]:
    """Inodes of all files that some process has locked. Asking the lock itself could keep a learner from taking it."""
    try:
        lines = LOCKS.read_text().splitlines()
    except OSError:
        return frozenset()
    # "1: FLOCK  ADVISORY  WRITE 1234 08:01:131 0 EOF"
    places = [line.split()[5] for line in lines if len(line.split()) > 5 and "FLOCK" in line]
    inodes = [place.rpartition(":")[2] for place in places]
    return frozenset(int(inode) for inode in inodes if inode.isdecimal())


def _size(path: Path) -> int:
    return sum(entry.lstat().st_size for entry in path.rglob("*") if entry.is_file())


def _modified_s(path: Path, names: set[str]) -> float:
    """The newest of the directory, its settings and summary, and its newest segment."""
    marks = [path / name for name in (SETTINGS, SUMMARY) if name in names]
    if LOG_DIRECTORY in names and (path / LOG_DIRECTORY).is_dir():
        marks += [entry for entry in (path / LOG_DIRECTORY).iterdir() if segment_number(entry) is not None]
    return max(mark.stat().st_mtime for mark in marks) if marks else path.stat().st_mtime


def _checkpointed_steps(path: Path, settings: dict[str, Any]) -> int | None:
    versions = [int(file.stem) for file in (path / CHECKPOINTS).glob("*.ckpt") if file.stem.isdecimal()]
    num_envs, num_steps = _integer(settings.get("num_envs")), _integer(settings.get("num_steps"))
    if not versions or num_envs is None or num_steps is None:
        return None
    return max(versions) * num_envs * num_steps


def _return(summary: dict[str, Any]) -> float | None:
    for name in ("eval_return_mean", "train_return_mean"):
        value = summary.get(name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    return None


def _integer(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _read_object(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
