"""What an actor does, in a file: for checks on its own machine, which need neither the network nor the learner."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from common.errors import SettingsError

OLD_S = 15.0
"""A living actor writes far more often; its slowest period is a question to a learner that does not answer (5 s)."""

Keep = Callable[[str, int], None]
"""(state, version of the policy held, below 0 for none)."""


@dataclass(frozen=True)
class ActorState:
    """What an actor said of itself: its state, its policy's version (below 0: none) and the Unix time in seconds."""

    state: str
    version: int
    time_s: float


def state_keeper(path: Path | None) -> Keep:
    """What keeps an actor's state in the file; where there is none, it keeps nothing.

    Raises:
        SettingsError: the file cannot be written. Later failures only let it grow old.
    """
    if path is None:
        return lambda state, version: None
    try:
        path.touch()
    except OSError as error:
        raise SettingsError(
            f"--state-file {path} cannot be written ({error.strerror}); choose a file in a directory that this user "
            "may write"
        ) from None
    return lambda state, version: _write(path, ActorState(state, version, time.time()))


def read_state(path: Path) -> ActorState | None:
    """What the actor said last; None where there is no such file, or nothing in it yet.

    Raises:
        SettingsError: the file is something else.
    """
    try:
        text = path.read_text()
        return ActorState(**json.loads(text)) if text else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError) as error:
        raise SettingsError(f"--state-file {path} is not one that an actor keeps: {error}") from None


def _write(path: Path, state: ActorState) -> None:
    """Beside, then renamed: a reader sees the whole of the old or of the new."""
    beside = path.with_suffix(".part")
    with suppress(OSError):
        beside.write_text(json.dumps(asdict(state)))
        beside.replace(path)
