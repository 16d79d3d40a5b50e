"""The state file of an actor or evaluator: health checks on the same machine read it without the network."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from common.errors import SettingsError
from common.remedies import remedy

OLD_S = 15.0
"""Age in seconds from which a state counts as stale.

A live worker writes far more often: its longest pause is a join request that is not answered (5 s).
"""

LEARNER_RESUMES = "learner resumes"
"""The state of a worker whose learner answers, and is still reading the log of its run."""

WriteState = Callable[[str, int], None]
"""Called with the state and the version of the policy held, which is negative for none."""


@dataclass(frozen=True)
class WorkerState:
    """A worker's state, the version of its policy (negative: none) and the Unix time in seconds of the report."""

    state: str
    version: int
    time_s: float


def state_writer(path: Path | None) -> WriteState:
    """A function that writes a worker's state to the file, or does nothing if `path` is None.

    Raises:
        SettingsError: the file cannot be written. Later failures are not raised: the file grows stale, which a health
            check notices.
    """
    if path is None:
        return lambda state, version: None
    try:
        path.touch()
    except OSError as error:
        raise SettingsError(f"--state-file {path} cannot be written ({error.strerror}); {remedy(error)}") from None
    return lambda state, version: _write(path, WorkerState(state, version, time.time()))


def read_state(path: Path) -> WorkerState | None:
    """The last state written; None if there is no such file or nothing in it yet.

    Raises:
        SettingsError: the file is not a state file.
    """
    try:
        text = path.read_text()
        return WorkerState(**json.loads(text)) if text else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError) as error:
        raise SettingsError(f"--state-file {path} is not one that an actor keeps: {error}") from None


def _write(path: Path, state: WorkerState) -> None:
    """Write a temporary file and rename it, so that a reader never sees half a state."""
    temporary = path.with_suffix(".part")
    with suppress(OSError):
        temporary.write_text(json.dumps(asdict(state)))
        temporary.replace(path)
