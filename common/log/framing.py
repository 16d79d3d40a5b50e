"""Records of an MCAP file as byte ranges, and the error for damaged ones."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Protocol, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.writer import MCAP0_MAGIC

from common.errors import LogReadError

MAGIC = MCAP0_MAGIC
"""The eight bytes at both ends of a file."""

RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length of the content, before every record."""

Record = TypeVar("Record", covariant=True)


class RecordType(Protocol[Record]):
    """A record class of mcap, with a parser."""

    def read(self, stream: ReadDataStream, /) -> Record: ...


@dataclass(frozen=True, slots=True)
class Frame:
    """One record of the file `path`: its content is the `length` bytes at offset `body`."""

    path: Path
    opcode: int
    body: int
    length: int

    @property
    def start(self) -> int:
        """Offset of the first byte of the record."""
        return self.body - RECORD_HEAD.size

    @property
    def end(self) -> int:
        """Offset of the first byte after the record."""
        return self.body + self.length


@dataclass(frozen=True)
class TornTail:
    """A segment without a footer: still being written, or its writer was killed.

    Its first `good_bytes` are complete records. The `dropped_bytes` after them are not, and none of their messages is
    returned.
    """

    path: Path
    good_bytes: int
    dropped_bytes: int


def damaged(path: Path, offset: int, what: str) -> LogReadError:
    """The error for a file that no writer left like this."""
    return LogReadError(
        f"{path} is damaged at byte {offset}: {what}; what follows cannot be trusted. Restore the file from a copy, "
        "or read the segments before it"
    )


def exactly(file: BinaryIO, size: int, path: Path) -> bytes:
    """The next `size` bytes, which the size of the file promised.

    Raises:
        LogReadError: the file has become shorter.
    """
    data = file.read(size)
    if len(data) != size:
        raise damaged(path, file.tell(), "it became shorter while it was read")
    return data


def parse(record_type: RecordType[Record], frame: Frame, content: bytes) -> Record:
    """The record in `content`.

    Raises:
        LogReadError: the bytes are not such a record.
    """
    try:
        return record_type.read(ReadDataStream(BytesIO(content)))
    except (McapError, struct.error, ValueError) as error:
        raise damaged(frame.path, frame.start, f"a record cannot be parsed ({error!r})") from error
