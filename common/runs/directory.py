"""The directory of a run: its name, its files, and writing them so that each is whole or absent."""

from __future__ import annotations

import itertools
import json
import os
import time
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.files import create, is_plain_directory
from common.log.lock import LOCK
from common.log.segments import LOG_DIRECTORY
from common.remedies import remedy
from common.tasks import slug

SUMMARY = "summary.json"
SETTINGS = "settings.json"
TENSORBOARD = "tensorboard"
CHECKPOINTS = "checkpoints"

KEPT_CHECKPOINTS = 3
"""Checkpoints that a run keeps: the newest."""

RUNS = Path("runs")
"""Parent of the run directories that no setting names."""


def prepare_run_dir(settings: RunSettings) -> Path:
    """Create the run's directory with its settings in it, and return it. SettingsError as `claim_run_dir`."""
    run_dir = claim_run_dir(settings)
    write_settings(run_dir, settings)
    return run_dir


def write_settings(run_dir: Path, settings: RunSettings) -> None:
    """Write the settings of a run into its directory. SettingsError where that is not possible."""
    try:
        write_json(run_dir / SETTINGS, settings.model_dump(mode="json"))
    except OSError as error:
        raise _cannot_write(run_dir, error) from None


def claim_run_dir(settings: RunSettings) -> Path:
    """Create the run's directory and return it. SettingsError where it holds another run or cannot be created."""
    if settings.run_dir is None:
        return _create_default(default_run_dir(settings))
    run_dir = settings.run_dir
    try:
        run_dir.mkdir(parents=True, exist_ok=True)
        taken = [name for name in (SUMMARY, SETTINGS) if (run_dir / name).exists()]
        taken += [LOG_DIRECTORY] if _has_log(run_dir / LOG_DIRECTORY) else []
    except OSError as error:
        raise _cannot_write(run_dir, error) from None
    if taken:
        raise SettingsError(
            f"run_dir {run_dir} already holds a run ({', '.join(taken)}); choose another directory, "
            "or move that run away"
        )
    return run_dir


def _create_default(run_dir: Path) -> Path:
    """Create a directory with that name, or with a number after it where the name is taken."""
    for number in itertools.count(2):
        try:
            run_dir.mkdir(parents=True, exist_ok=False)
        except FileExistsError:
            run_dir = run_dir.with_name(f"{run_dir.name.removesuffix(f'-{number - 1}')}-{number}")
            continue
        except OSError as error:
            raise _cannot_write(run_dir, error) from None
        break
    return run_dir


def _has_log(directory: Path) -> bool:
    # A lock alone is left where a learner was killed before it had written anything.
    return directory.exists() and not (is_plain_directory(directory) and set(os.listdir(directory)) <= {LOCK})


def _cannot_write(run_dir: Path, error: OSError) -> SettingsError:
    return SettingsError(f"run_dir {run_dir} cannot be written ({error.strerror}); {remedy(error)}, with --run-dir")


def default_run_dir(settings: RunSettings) -> Path:
    stamp = time.strftime("%Y%m%d-%H%M%S")
    return RUNS / f"{slug(settings.task)}-{settings.learner}-s{settings.seed}-{stamp}"


def write_json(path: Path, content: dict[str, Any], *, indent: int | None = 2) -> None:
    """Write to a temporary file, sync it and rename it: the file is whole or absent."""
    beside = path.with_suffix(path.suffix + ".part")
    with create(beside) as file:
        file.write(json.dumps(content, indent=indent).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
