"""One segment of the log being written: an MCAP file that is whole up to its last commit."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Literal, cast

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from common.log.checksums import use_in_writer
from common.log.records import CHANNELS, ChannelSpec, encode_json
from common.log.segments import sync_directory

PROFILE = "reskpn"
"""Profile in the header of every segment: identifies the files of this program."""

Compression = Literal["none", "lz4"]
Metadata = Mapping[str, Mapping[str, str]]
Attachments = Mapping[str, tuple[str, bytes]]

_COMPRESSION = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4}
_ENCODING = {"json": MessageEncoding.JSON, "msgpack": MessageEncoding.MessagePack}
_CHUNK_BYTES = 1_000_000
_NO_SCHEMA = 0

use_in_writer()


class _Output:
    """The stream that mcap writes to: a new file without a buffer of its own.

    A buffer would keep the bytes of a write that failed and try them again on closing.
    """

    def __init__(self, path: Path) -> None:
        # Appending, so that a file that another program cuts has another size than was written.
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
        self.file = open(path, "wb", buffering=0, opener=lambda name, _: os.open(name, flags, 0o666))  # noqa: SIM115
        self.offset = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            written = self.file.write(view) or 0
            self.offset += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        return self.offset

    def flush(self) -> None:
        """Do nothing: every write has gone to the operating system."""


class SegmentWriter:
    """Writes the new file `path`: header and metadata at once, then messages, which `commit` makes lasting.

    Every method that writes raises OSError. After one the segment must be closed with `abandon`, which leaves only
    the committed bytes in the file.
    """

    def __init__(
        self, path: Path, *, compression: Compression, metadata: Metadata, attachments: Attachments, t_ns: int
    ) -> None:
        self.path = path
        self._committed = 0
        self._messages = 0
        self._output = _Output(path)
        self._writer = Writer(
            cast(IO[bytes], self._output),
            chunk_size=_CHUNK_BYTES,
            compression=_COMPRESSION[compression],
            enable_crcs=True,
        )
        try:
            self._begin(metadata, attachments, t_ns)
            sync_directory(path.parent)
        except BaseException:
            self.abandon()
            raise

    @property
    def size(self) -> int:
        """Bytes of the file so far."""
        return self._output.offset

    @property
    def messages(self) -> int:
        """Messages added so far; each has as its sequence number the count of those before it."""
        return self._messages

    def add(self, topic: str, t_ns: int, data: bytes) -> None:
        """Append a message. It is certain to be in the file only after `commit`."""
        self._writer.add_message(self._channels[topic], t_ns, data, publish_time=t_ns, sequence=self._messages)
        self._messages += 1

    def commit(self) -> None:
        """Close the chunk and hand all that was added to the operating system: it outlives the process."""
        self._writer.flush()
        if os.fstat(self._output.file.fileno()).st_size != self._output.offset:
            raise OSError(errno.ESTALE, "it was changed by another program while it was written")
        self._committed = self._output.offset

    def sync(self) -> None:
        """Make what was committed survive a loss of power."""
        os.fdatasync(self._output.file.fileno())
        self._require_in_place()

    def finish(self) -> None:
        """Write summary, indexes and footer, sync and close."""
        self._writer.finish()
        self.sync()
        self._output.file.close()

    def abandon(self) -> None:
        """Cut the file back to the last commit and close it; remove it where not even its start was written."""
        file = self._output.file
        if file.closed:
            return
        # A cut that fails leaves a torn tail, which readers recognise.
        with contextlib.suppress(OSError):
            file.truncate(self._committed)
            if self._committed == 0:
                self.path.unlink()
        with contextlib.suppress(OSError):
            file.close()

    def _require_in_place(self) -> None:
        # What is written to a file without a name is lost with the process.
        try:
            there = self.path.stat(follow_symlinks=False)
        except FileNotFoundError:
            there = None
        here = os.fstat(self._output.file.fileno())
        if there is None or (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            raise OSError(errno.ESTALE, "it was removed or replaced while it was written")

    def _begin(self, metadata: Metadata, attachments: Attachments, t_ns: int) -> None:
        self._writer.start(profile=PROFILE)
        for name, values in metadata.items():
            self._writer.add_metadata(name, dict(values))
        for name, (media_type, data) in attachments.items():
            self._writer.add_attachment(create_time=t_ns, log_time=t_ns, name=name, media_type=media_type, data=data)
        self._channels = {topic: self._register(channel) for topic, channel in CHANNELS.items()}
        self._committed = self._output.offset

    def _register(self, channel: ChannelSpec) -> int:
        schema_id = _NO_SCHEMA
        if channel.schema is not None:
            schema_id = self._writer.register_schema(
                channel.schema_name, SchemaEncoding.JSONSchema, encode_json(channel.schema)
            )
        return self._writer.register_channel(channel.topic, _ENCODING[channel.encoding], schema_id)
