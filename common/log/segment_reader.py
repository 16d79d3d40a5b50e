"""One segment of the log being read: every record of the file is checked, and its end may be missing."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Statistics
from mcap.stream_reader import StreamReader

from common.errors import LogReadError
from common.files import open_to_read
from common.log.checksums import crc32
from common.log.chunks import read_chunk, read_chunk_head
from common.log.framing import MAGIC, RECORD_HEAD, Frame, TornTail, damaged, exactly, parse
from common.log.records import LogMessage
from common.log.segment_writer import PROFILE
from common.log.segments import unreadable

_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, start of its offsets, CRC
_CRC_BYTES = 4
_BUFFER_BYTES = 1 << 16  # larger reads pass the buffer by
MAX_RECORD_BYTES = 1 << 30
"""Of a record other than a chunk, and of the summary at the end."""

_ZEROS_BYTES = 1 << 20
_DATA_SECTION = frozenset(
    (
        Opcode.HEADER,
        Opcode.CHUNK,
        Opcode.MESSAGE_INDEX,
        Opcode.ATTACHMENT,
        Opcode.METADATA,
        Opcode.DATA_END,
    )
)


@dataclass(frozen=True)
class Summary:
    """The message counts at the end of a finished segment."""

    messages: int
    counts: dict[str, int]


class SegmentReader:
    """Reads the file `path` as it was when this object was made; later records are not seen.

    CRCs cover messages, attachments and the summary; the format has none for metadata. Any mismatch in bytes,
    framing or count raises LogReadError with path and offset; only the end of a segment without a footer
    may be incomplete.

    `begin`: the offset of a record, up to which another reader has read this segment.
    """

    def __init__(self, path: Path, begin: int = 0) -> None:
        self.path = path
        self._begin = max(begin, len(MAGIC))
        try:
            self.size = path.stat(follow_symlinks=False).st_size
        except OSError as error:
            raise unreadable(path, error) from error

    def messages(self, topics: Collection[str] | None = None) -> Iterator[LogMessage]:
        """The messages of the complete chunks in the order they were written; all topics if None.

        Holds one chunk in memory at a time.
        """
        for _, messages in self.chunks({}):
            for message in messages:
                if topics is None or message.topic in topics:
                    yield message

    def chunks(self, names: dict[int, str], count: int = 0) -> Iterator[tuple[int, list[LogMessage]]]:
        """The offset after each complete chunk, and its messages.

        `names`: topics by channel as the chunks before `begin` declare them, added to here; `count`: of their messages.
        """
        with self._opened() as file:
            for frame in self._frames(file):
                if frame.opcode != Opcode.CHUNK:
                    continue
                messages = read_chunk(file, frame, names)
                for message in messages:
                    if message.sequence != count:
                        raise self._damaged(frame.start, f"message {message.sequence} comes in place of {count}")
                    count += 1
                yield frame.end, messages
        if self.summary is not None and self.summary.messages != count:
            raise self._damaged(self.size, f"{count} messages are left of {self.summary.messages}")

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata by name."""
        found = (parse(Metadata, frame, content) for frame, content in self._before_chunks(Opcode.METADATA))
        return {record.name: record.metadata for record in found}

    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """The attachments: name -> (media type, content)."""
        found: dict[str, tuple[str, bytes]] = {}
        for frame, content in self._before_chunks(Opcode.ATTACHMENT):
            if crc32(content[:-_CRC_BYTES]) != int.from_bytes(content[-_CRC_BYTES:], "little"):
                raise self._damaged(frame.start, "the CRC of an attachment does not match")
            record = parse(Attachment, frame, content)
            found[record.name] = (record.media_type, record.data)
        return found

    def counts(self) -> dict[str, int]:
        """Messages by topic: from the summary where there is one, else by reading them all."""
        if self.summary is not None:
            return self.summary.counts
        return dict(Counter(message.topic for message in self.messages()))

    @cached_property
    def torn(self) -> TornTail | None:
        """Where the complete records end; None for a finished segment."""
        if self.summary is not None:
            return None
        good = len(MAGIC) if self.size >= len(MAGIC) else 0
        with self._opened() as file:
            for frame in self._frames(file):
                if frame.opcode != Opcode.DATA_END:
                    good = frame.end
        return TornTail(self.path, good, self.size - good)

    @cached_property
    def compression(self) -> str:
        """Compression of the chunks as MCAP names it, "none" where there is none, or no chunk."""
        with self._opened() as file:
            for frame in self._frames(file):
                if frame.opcode == Opcode.CHUNK:
                    return read_chunk_head(file, frame).compression or "none"
        return "none"

    @cached_property
    def summary(self) -> Summary | None:
        """The checked summary; None where the file has no footer."""
        footer = self.size - len(MAGIC) - _FOOTER.size
        if footer < len(MAGIC):
            return None
        with self._opened() as file:
            file.seek(footer)
            opcode, length, start, _, crc = _FOOTER.unpack(exactly(file, _FOOTER.size, self.path))
            ends = exactly(file, len(MAGIC), self.path) == MAGIC
            if not ends or opcode != Opcode.FOOTER or length != _FOOTER.size - RECORD_HEAD.size:
                return None
            if not 0 < start <= footer:
                raise self._damaged(footer, "the footer points outside the file")
            if self.size - start > MAX_RECORD_BYTES:
                raise self._damaged(start, "the summary is larger than any learner writes")
            file.seek(start)
            content = exactly(file, self.size - start, self.path)
        if crc32(content[: footer + _FOOTER.size - _CRC_BYTES - start]) != crc:
            raise self._damaged(start, "the CRC of the summary does not match")
        return self._parse_summary(content, start)

    def _parse_summary(self, content: bytes, start: int) -> Summary:
        topics: dict[int, str] = {}
        statistics: Statistics | None = None
        for record in StreamReader(BytesIO(content), skip_magic=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Statistics):
                statistics = record
        if statistics is None:
            raise self._damaged(start, "the summary has no statistics")
        counts = statistics.channel_message_counts
        return Summary(statistics.message_count, {topics[channel]: count for channel, count in counts.items()})

    def _before_chunks(self, opcode: Opcode) -> Iterator[tuple[Frame, bytes]]:
        """The records of one kind that precede the messages, with their content."""
        with self._opened() as file:
            for frame in self._frames(file):
                if frame.opcode == Opcode.CHUNK:
                    return
                if frame.opcode == opcode:
                    yield frame, self._small(file, frame)

    def _frames(self, file: BinaryIO) -> Iterator[Frame]:
        """The complete records of the data section in order, `file` being at the content of each."""
        start = self._begin
        while start + RECORD_HEAD.size <= self._end:
            file.seek(start)
            opcode, length = RECORD_HEAD.unpack(exactly(file, RECORD_HEAD.size, self.path))
            frame = Frame(self.path, opcode, start + RECORD_HEAD.size, length)
            if opcode not in _DATA_SECTION or (start == len(MAGIC)) != (opcode == Opcode.HEADER):
                raise self._damaged(start, f"a record with opcode {opcode} has no place there")
            if frame.end > self._end:
                break
            if opcode == Opcode.HEADER:
                self._check_header(file, frame)
                file.seek(frame.body)
            yield frame
            if opcode == Opcode.DATA_END:
                return
            start = frame.end
        if self.summary is not None:
            raise self._damaged(start, "a record runs past the end of the file")

    @cached_property
    def _end(self) -> int:
        """Offset up to which there may be records.

        A file system can leave zeros in the place of what was written last before a loss of power: where a segment
        without a footer ends in zeros, its last records count only as far as they are whole.
        """
        if self.size < len(MAGIC) or self.summary is not None:
            return self.size
        with self._opened() as file:
            zeros = self._start_of_zeros(file)
            start = self._begin
            while start < zeros and start + RECORD_HEAD.size <= self.size:
                file.seek(start)
                opcode, length = RECORD_HEAD.unpack(exactly(file, RECORD_HEAD.size, self.path))
                frame = Frame(self.path, opcode, start + RECORD_HEAD.size, length)
                if frame.end > self.size or opcode not in _DATA_SECTION:
                    return self.size
                if frame.end > zeros and not self._is_whole(file, frame, zeros):
                    return start
                start = frame.end
        return self.size if zeros == self.size else min(self.size, max(start, zeros))

    def _is_whole(self, file: BinaryIO, frame: Frame, zeros: int) -> bool:
        """True unless the zeros from that offset on are in the place of a part of the record."""
        if frame.opcode != Opcode.CHUNK:
            return frame.opcode in (Opcode.MESSAGE_INDEX, Opcode.DATA_END) or frame.end - zeros <= RECORD_HEAD.size
        try:
            read_chunk(file, frame, dict.fromkeys(range(1 << 16), ""))
        except LogReadError:
            return False
        return True

    def _start_of_zeros(self, file: BinaryIO) -> int:
        """Offset of the zeros at the end of the file; its size where it ends otherwise."""
        end = self.size
        while end > 0:
            begin = max(0, end - _ZEROS_BYTES)
            file.seek(begin)
            left = exactly(file, end - begin, self.path).rstrip(b"\0")
            if left:
                return begin + len(left)
            end = begin
        return 0

    def _check_header(self, file: BinaryIO, frame: Frame) -> None:
        header = parse(Header, frame, self._small(file, frame))
        if header.profile != PROFILE:
            raise LogReadError(
                f"{self.path} is of another program: its profile is {header.profile!r}, not {PROFILE!r}; give the log "
                "of a run"
            )

    def _small(self, file: BinaryIO, frame: Frame) -> bytes:
        """The content of a record that is read whole."""
        if frame.length > MAX_RECORD_BYTES:
            raise self._damaged(frame.start, f"a record is said to have {frame.length} bytes; no learner writes such")
        return exactly(file, frame.length, self.path)

    @contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        try:
            with open_to_read(self.path, _BUFFER_BYTES) as file:
                if not MAGIC.startswith(file.read(min(self.size, len(MAGIC)))):
                    raise LogReadError(f"{self.path} is not an MCAP file; give the log of a run")
                yield file
        except OSError as error:
            raise unreadable(self.path, error) from error

    def _damaged(self, offset: int, what: str) -> LogReadError:
        return damaged(self.path, offset, what)
