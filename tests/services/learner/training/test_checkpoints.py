"""Checkpoint files: whole or not there, and never many."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from samples import snapshot

from common.errors import CheckpointError
from services.learner.training.checkpoints import (
    KeptEnvironments,
    list_checkpoints,
    quarantine,
    read_checkpoint,
    read_environments,
    write_checkpoint,
    write_environments,
)


def test_a_state_comes_back_as_it_was_kept(tmp_path: Path) -> None:
    """Run, version, digest and every array, with dtype and shape."""
    kept = snapshot(7)
    path = write_checkpoint(tmp_path, kept)
    assert path == tmp_path / "checkpoints" / "00000007.ckpt"
    found = read_checkpoint(path)
    assert (found.run, found.version, found.digest) == (kept.run, 7, kept.digest)
    assert found.arrays.keys() == kept.arrays.keys()
    for name, array in kept.arrays.items():
        assert found.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(found.arrays[name], array, strict=True)


@pytest.mark.parametrize("kept_bytes", [0, 1, 50, -1])
def test_a_torn_file_is_refused(tmp_path: Path, kept_bytes: int) -> None:
    """A file that lost its end, be it one byte, is damaged; the message says to use an older one."""
    path = write_checkpoint(tmp_path, snapshot(1))
    path.write_bytes(path.read_bytes()[:kept_bytes])
    with pytest.raises(CheckpointError, match=r"00000001\.ckpt is damaged: .*Use an older one beside it"):
        read_checkpoint(path)


def test_no_flipped_bit_changes_a_state(tmp_path: Path) -> None:
    """Whatever byte of the file changes, reading it is an error, or the arrays are those that were kept."""
    path = write_checkpoint(tmp_path, snapshot(1))
    whole = path.read_bytes()
    good = read_checkpoint(path)
    refused = 0
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :])
        try:
            found = read_checkpoint(path)
        except CheckpointError:
            refused += 1
        else:
            # The digest is of the arrays; only the names around them can be others.
            assert (found.run, found.version) != (good.run, good.version)
            assert found.digest == good.digest
            for name, array in good.arrays.items():
                np.testing.assert_array_equal(found.arrays[name], array, strict=True)
    # 5 bytes of the run's name and one of the version, and nothing else, can change unnoticed.
    assert len(whole) - refused <= 6


def test_an_absent_file(tmp_path: Path) -> None:
    """Named, with the reason."""
    with pytest.raises(CheckpointError, match=r"cannot read the checkpoint .*00000009\.ckpt: No such file"):
        read_checkpoint(tmp_path / "00000009.ckpt")


def test_only_whole_files_are_listed(tmp_path: Path) -> None:
    """Oldest first; not what a write that was cut short left behind, nor foreign files. No folder: no checkpoints."""
    assert list_checkpoints(tmp_path) == []
    paths = [write_checkpoint(tmp_path, snapshot(version)) for version in (2, 10)]
    for stray in ("00000011.part", "00000012.ckpt.part", "latest.ckpt", "1.ckpt"):
        (tmp_path / "checkpoints" / stray).write_bytes(b"")
    assert list_checkpoints(tmp_path) == paths


def test_the_newest_three_are_kept(tmp_path: Path) -> None:
    """By version; and nothing half written stays."""
    for version in (5, 50, 500, 1000, 99999):
        write_checkpoint(tmp_path, snapshot(version))
    names = sorted(path.name for path in (tmp_path / "checkpoints").iterdir())
    assert names == ["00000500.ckpt", "00001000.ckpt", "00099999.ckpt"]


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    """A sentence with the path, the reason and what to do."""
    (tmp_path / "checkpoints").write_text("a file where the folder should be")
    with pytest.raises(
        CheckpointError,
        match=r"cannot write the checkpoint .*00000001\.ckpt: File exists; something else is in its place",
    ):
        write_checkpoint(tmp_path, snapshot(1))


def test_a_write_that_fails_leaves_the_older_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a full disk the checkpoints that were there are there, and the half of the new one is gone."""
    older = write_checkpoint(tmp_path, snapshot(1))

    def full(descriptor: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("services.learner.training.checkpoints.os.fsync", full)
    with pytest.raises(CheckpointError, match="No space left on device"):
        write_checkpoint(tmp_path, snapshot(2))
    assert list((tmp_path / "checkpoints").iterdir()) == [older]
    assert read_checkpoint(older).version == 1


def environments(version: int) -> KeptEnvironments:
    """Of three slots, the second without an actor."""
    return KeptEnvironments("run-1", version, [1, 4, 2], {0: b"state of 0", 2: b"state of 2"})


def test_environments_come_back_as_they_were_handed_in(tmp_path: Path) -> None:
    """Beside the checkpoint of their version; None where there are none."""
    path = write_checkpoint(tmp_path, snapshot(7))
    assert read_environments(path) is None
    assert write_environments(tmp_path, environments(7)) == path.with_suffix(".env")
    assert read_environments(path) == environments(7)
    assert list_checkpoints(tmp_path) == [path]


def test_damaged_environments_are_refused(tmp_path: Path) -> None:
    """As a checkpoint is; and so is another file in their place."""
    path = write_checkpoint(tmp_path, snapshot(7))
    kept = write_environments(tmp_path, environments(7))
    whole = kept.read_bytes()
    kept.write_bytes(whole[:-1])
    with pytest.raises(CheckpointError, match=r"00000007\.env is damaged"):
        read_environments(path)
    kept.write_bytes(path.read_bytes())
    with pytest.raises(CheckpointError, match=r"00000007\.env holds no environments"):
        read_environments(path)


def test_the_newest_with_environments_is_kept(tmp_path: Path) -> None:
    """Whatever came after it without: the run can go on from it alone. Those of an older one go with it."""
    for version in (5, 10, 15, 20, 25):
        write_checkpoint(tmp_path, snapshot(version))
        if version <= 10:
            write_environments(tmp_path, environments(version))
    names = sorted(path.name for path in (tmp_path / "checkpoints").iterdir())
    assert names == [f"000000{name}" for name in ("10.ckpt", "10.env", "15.ckpt", "20.ckpt", "25.ckpt")]


def test_what_is_put_aside_is_not_listed(tmp_path: Path) -> None:
    """State and environments stay, under another name."""
    path = write_checkpoint(tmp_path, snapshot(7))
    write_environments(tmp_path, environments(7))
    quarantine(path)
    assert list_checkpoints(tmp_path) == []
    names = sorted(path.name for path in (tmp_path / "checkpoints").iterdir())
    assert names == ["00000007.ckpt.bad", "00000007.env.bad"]
