"""Checkpoint files: the whole learner state, written so that a reader finds all of it or none.

A file is `checkpoints/<version>.ckpt`: one wire message (msgpack) with schema, run, version, digest and arrays. It is
written beside, synced and renamed; the newest few are kept. `<version>.env` beside it, of the same form, holds the
environments as they were when that version was published: with both a run can go on.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.errors import CheckpointError, CodecError
from common.files import create, read_bytes
from common.log.segments import sync_directory
from common.remedies import remedy
from common.runs.directory import CHECKPOINTS, KEPT_CHECKPOINTS
from common.wire.codec import Limits
from common.wire.messages import Snapshot, digest_arrays

ENVIRONMENTS = ".env"
"""Suffix of the file with the environments of a checkpoint."""

_GIVEN = "given"
_NAME = re.compile(r"(\d{8})\.ckpt")
_LIMITS = Limits(max_message=1 << 32, max_bin=1 << 32)


def write_checkpoint(run_dir: Path, state: Snapshot, kept: int = KEPT_CHECKPOINTS) -> Path:
    """Write a state, then delete all but the newest `kept`.

    Raises:
        CheckpointError: the file cannot be written; older checkpoints are untouched.
    """
    path = run_dir / CHECKPOINTS / f"{state.version:08d}.ckpt"
    _write(path, state)
    _drop_old(run_dir, kept)
    return path


@dataclass(frozen=True)
class KeptEnvironments:
    """The environments of all slots at a version.

    `given` says how often each slot was given out; `states` are the `Environment` messages of the slots whose actors
    were there, in the bytes received.
    """

    run: str
    version: int
    given: Sequence[int]
    states: Mapping[int, bytes]


def write_environments(run_dir: Path, kept: KeptEnvironments) -> Path:
    """Write the environments beside the checkpoint of their version. CheckpointError as `write_checkpoint`."""
    path = run_dir / CHECKPOINTS / f"{kept.version:08d}{ENVIRONMENTS}"
    arrays = {str(slot): np.frombuffer(data, np.uint8) for slot, data in kept.states.items()}
    arrays[_GIVEN] = np.array(kept.given, np.int64)
    _write(path, Snapshot(kept.run, kept.version, digest_arrays(arrays), arrays))
    return path


def read_environments(checkpoint: Path) -> KeptEnvironments | None:
    """The environments beside a checkpoint; None where there are none. CheckpointError as `read_checkpoint`."""
    path = checkpoint.with_suffix(ENVIRONMENTS)
    if not path.exists():
        return None
    kept = read_checkpoint(path)
    if _GIVEN not in kept.arrays:
        raise CheckpointError(f"{path} holds no environments. Use an older checkpoint beside it")
    states = {int(slot): array.tobytes() for slot, array in kept.arrays.items() if slot != _GIVEN}
    return KeptEnvironments(kept.run, kept.version, kept.arrays[_GIVEN].tolist(), states)


def quarantine(checkpoint: Path) -> None:
    """Rename a damaged checkpoint, and its environments, to ".bad": it is not read any more, and can be examined."""
    for path in (checkpoint, checkpoint.with_suffix(ENVIRONMENTS)):
        if path.exists():
            path.replace(path.with_name(path.name + ".bad"))


def list_checkpoints(run_dir: Path) -> list[Path]:
    """The complete checkpoint files of a run, oldest first."""
    folder = run_dir / CHECKPOINTS
    return sorted(path for path in folder.glob("*.ckpt") if _NAME.fullmatch(path.name))


def read_checkpoint(path: Path) -> Snapshot:
    """The state in a file.

    Raises:
        CheckpointError: the file is absent, damaged (its digest does not hold) or of another schema.
    """
    try:
        return Snapshot.decode(read_bytes(path), _LIMITS)
    except OSError as error:
        raise CheckpointError(f"cannot read the checkpoint {path}: {error.strerror}") from None
    except CodecError as error:
        raise CheckpointError(f"the checkpoint {path} is damaged: {error}. Use an older one beside it") from None


@dataclass(frozen=True)
class Checkpoints:
    """The checkpoint files of one run, of which `kept` are left. CheckpointError where one cannot be written."""

    run: str
    run_dir: Path
    kept: int = KEPT_CHECKPOINTS

    def keep(self, version: int, state: dict[str, np.ndarray]) -> None:
        write_checkpoint(self.run_dir, Snapshot(self.run, version, digest_arrays(state), state), self.kept)

    def keep_environments(self, kept: KeptEnvironments) -> None:
        write_environments(self.run_dir, kept)


def _write(path: Path, content: Snapshot) -> None:
    beside = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with create(beside) as file:
            file.write(content.encode())
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        sync_directory(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise _failure(path, error) from None


def _failure(path: Path, error: OSError) -> CheckpointError:
    return CheckpointError(
        f"cannot write the checkpoint {path}: {error.strerror or error}; {remedy(error)}, then resume the "
        "run: its log is whole and holds the run so far"
    )


def _drop_old(run_dir: Path, kept: int) -> None:
    """Delete all but the newest few, and the newest that has its environments: the run can go on from that."""
    present = list_checkpoints(run_dir)
    complete = [path for path in present if path.with_suffix(ENVIRONMENTS).exists()]
    for old in present[:-kept]:
        if old in complete[-1:]:
            continue
        try:
            # The environments first: a reader that finds them may rely on the checkpoint beside them.
            old.with_suffix(ENVIRONMENTS).unlink(missing_ok=True)
            old.unlink(missing_ok=True)
        except OSError as error:
            raise _failure(old, error) from None
