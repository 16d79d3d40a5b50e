"""Checkpoint files: the whole learner state, written so that a reader finds it whole or not at all.

A file is `checkpoints/<version>.ckpt`: one wire message (msgpack) with schema, run, version, digest and arrays. It is
written beside, synced and renamed; the newest few are kept.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

from common.errors import CheckpointError, CodecError
from common.wire.codec import Limits
from common.wire.messages import Snapshot

DIRECTORY = "checkpoints"
KEEP = 3

_NAME = re.compile(r"(\d{8})\.ckpt")
_LIMITS = Limits(max_message=1 << 32, max_bin=1 << 32)


def write_checkpoint(run_dir: Path, state: Snapshot) -> Path:
    """Keep a state, then drop all but the newest few.

    Raises:
        CheckpointError: the file cannot be written; older checkpoints are untouched.
    """
    folder = run_dir / DIRECTORY
    path = folder / f"{state.version:08d}.ckpt"
    beside = path.with_suffix(".part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with beside.open("wb") as file:
            file.write(state.encode())
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        _sync(folder)
        for old in list_checkpoints(run_dir)[:-KEEP]:
            old.unlink()
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise CheckpointError(
            f"cannot write the checkpoint {path}: {error.strerror}. Make room or fix its permissions; "
            "the log is whole and holds the run so far"
        ) from None
    return path


def list_checkpoints(run_dir: Path) -> list[Path]:
    """All whole checkpoints of a run, oldest first."""
    folder = run_dir / DIRECTORY
    return sorted(path for path in folder.glob("*.ckpt") if _NAME.fullmatch(path.name))


def read_checkpoint(path: Path) -> Snapshot:
    """The state in a file.

    Raises:
        CheckpointError: the file is absent, damaged (its digest does not hold) or of another schema.
    """
    try:
        return Snapshot.decode(path.read_bytes(), _LIMITS)
    except OSError as error:
        raise CheckpointError(f"cannot read the checkpoint {path}: {error.strerror}") from None
    except CodecError as error:
        raise CheckpointError(f"the checkpoint {path} is damaged: {error}. Use an older one beside it") from None


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
