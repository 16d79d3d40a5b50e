"""The messages of one chunk.

mcap's own readers load a chunk, copy it, and copy every message out of it again. Rollouts are large, so here the
payload of a message goes straight from the file into the bytes that the caller gets, with the CRC taken on the way.
No message of a chunk is returned before all of it is checked.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO, Protocol

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel

from common.log.checksums import crc32
from common.log.framing import RECORD_HEAD, Frame, damaged, exactly, parse
from common.log.records import LogMessage

_HEAD = struct.Struct("<QQQII")  # first time, last time, uncompressed size, CRC, length of the compression's name
_LENGTH = struct.Struct("<Q")
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
MAX_CHUNK_BYTES = 2 << 30
"""A chunk holds a megabyte and at most one message more, which is far below this; what is larger is not read."""

_COMPRESSIONS = frozenset((b"", b"lz4", b"zstd"))


class _Source(Protocol):
    def read(self, size: int, /) -> bytes: ...


@dataclass(frozen=True)
class ChunkHead:
    """The start of a chunk; `size` is that of its records as stored."""

    first_ns: int
    last_ns: int
    uncompressed_size: int
    crc: int
    compression: str
    size: int


def read_chunk_head(file: BinaryIO, frame: Frame) -> ChunkHead:
    """Read the head of the chunk `frame`, whose content `file` is at.

    Raises:
        LogReadError: its sizes do not agree.
    """
    fixed = _HEAD.size + _LENGTH.size
    if frame.length < fixed:
        raise damaged(frame.path, frame.start, "a chunk is too short")
    first, last, uncompressed, crc, name_size = _HEAD.unpack(exactly(file, _HEAD.size, frame.path))
    if name_size > frame.length - fixed:
        raise damaged(frame.path, frame.start, "the sizes of a chunk do not agree")
    name = exactly(file, name_size, frame.path)
    (size,) = _LENGTH.unpack(exactly(file, _LENGTH.size, frame.path))
    if name not in _COMPRESSIONS:
        raise damaged(frame.path, frame.start, f"there is no compression {name!r}")
    if max(uncompressed, size) > MAX_CHUNK_BYTES:
        raise damaged(frame.path, frame.start, f"a chunk is said to have {uncompressed} bytes; no learner writes such")
    if fixed + name_size + size != frame.length or (not name and uncompressed != size):
        raise damaged(frame.path, frame.start, "the sizes of a chunk do not agree")
    return ChunkHead(first, last, uncompressed, crc, name.decode(), size)


def read_chunk(file: BinaryIO, frame: Frame, topics: dict[int, str]) -> list[LogMessage]:
    """All messages of the chunk `frame`, whose content `file` is at, in order.

    Args:
        topics: topic by channel id as declared in the file so far; the channels of this chunk are added.

    Raises:
        LogReadError: the CRC does not match, or the content is no sequence of records.
    """
    head = read_chunk_head(file, frame)
    source: _Source = file if not head.compression else _decompressed(file, frame, head)
    payloads, channels, crc = _walk(source, frame, head.uncompressed_size)
    if crc != head.crc:
        raise damaged(frame.path, frame.start, f"a chunk has CRC {crc:#010x}, its head says {head.crc:#010x}")
    for content in channels:
        channel = parse(Channel, frame, content)
        topics[channel.id] = channel.topic
    messages = []
    for prefix, data in payloads:
        channel_id, sequence, t_ns, _ = _MESSAGE_HEAD.unpack(prefix)
        if channel_id not in topics:
            raise damaged(frame.path, frame.start, f"a message is of channel {channel_id}, which is not declared")
        messages.append(LogMessage(topics[channel_id], t_ns, sequence, data))
    return messages


def _walk(source: _Source, frame: Frame, size: int) -> tuple[list[tuple[bytes, bytes]], list[bytes], int]:
    """Split the `size` bytes of `source`: (message head, message data), channel records, and their CRC.

    The bytes are not checked yet, so no length is trusted that leaves the chunk.
    """
    payloads: list[tuple[bytes, bytes]] = []
    channels: list[bytes] = []
    crc, left = 0, size
    while left:
        head = source.read(min(RECORD_HEAD.size, left))
        crc = crc32(head, crc)
        left -= len(head)
        if len(head) < RECORD_HEAD.size:
            raise damaged(frame.path, frame.start, "a chunk ends within a record")
        opcode, length = RECORD_HEAD.unpack(head)
        if length > left or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD.size):
            raise damaged(frame.path, frame.start, "the length of a record in a chunk is impossible")
        prefix = source.read(_MESSAGE_HEAD.size) if opcode == Opcode.MESSAGE else b""
        data = source.read(length - len(prefix))
        if len(prefix) + len(data) != length:
            raise damaged(frame.path, frame.start, "a chunk is shorter than its head says")
        crc = crc32(data, crc32(prefix, crc))
        left -= length
        if opcode == Opcode.MESSAGE:
            payloads.append((prefix, data))
        elif opcode == Opcode.CHANNEL:
            channels.append(data)
    return payloads, channels, crc


def _decompressed(file: BinaryIO, frame: Frame, head: ChunkHead) -> _Source:
    data = exactly(file, head.size, frame.path)
    try:
        content = _DECOMPRESS[head.compression](data, head.uncompressed_size + 1)
    except Exception as error:  # each decompressor raises its own
        raise damaged(frame.path, frame.start, f"a chunk cannot be decompressed ({error})") from error
    if len(content) != head.uncompressed_size:
        size = len(content) if len(content) < head.uncompressed_size else "more"
        raise damaged(frame.path, frame.start, f"a chunk has {size} bytes, its head says {head.uncompressed_size}")
    return BytesIO(content)


def _lz4(data: bytes, limit: int) -> bytes:
    """At most `limit` bytes of the content."""
    content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit)
    return content


def _zstd(data: bytes, limit: int) -> bytes:
    """At most `limit` bytes of the content."""
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        return bytes(reader.read(limit))


_DECOMPRESS = {"lz4": _lz4, "zstd": _zstd}
