"""Logs for the tests of this folder."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from common.log.reader import LogReader
from common.log.segment_writer import Compression
from common.log.writer import LogWriter

DEADLINE_S = 20.0

METADATA = {"run": {"name": "probe", "git_commit": "0123abcd"}, "versions": {"python": "3.11"}}
ATTACHMENTS = {"model.xml": ("application/xml", b"<mujoco/>")}


def payload(number: int, size: int = 100) -> bytes:
    """Bytes that tell their number and that no other number has."""
    pattern = number.to_bytes(4, "little")
    return (pattern * (size // 4 + 1))[:size]


@pytest.fixture
def write_log() -> Callable[..., Path]:
    """Writes a finished log of numbered rollouts, `sizes[i]` bytes each, every one in a chunk of its own."""

    def write(
        directory: Path, sizes: list[int], *, compression: Compression = "none", segment_bytes: int = 1 << 30
    ) -> Path:
        with LogWriter(
            directory,
            compression=compression,
            segment_bytes=segment_bytes,
            metadata=METADATA,
            attachments=ATTACHMENTS,
        ) as log:
            for number, size in enumerate(sizes):
                log.write("/rollout", payload(number, size), t_ns=number)
                log.flush(DEADLINE_S)
        return directory

    return write


@pytest.fixture
def read_back() -> Callable[[Path], list[bytes]]:
    """The data of all messages of a log."""

    def read(path: Path) -> list[bytes]:
        return [message.data for message in LogReader(path).messages()]

    return read


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB. Needs the right to mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"cannot mount a tmpfs here: {mounted.stderr.decode().strip()}")
    yield place
    subprocess.run(["umount", str(place)], check=True)
