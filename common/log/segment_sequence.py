"""The segments of a log that is being written: a new one is begun when the current one is full."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

from common.log.chain import METADATA, SEALED, Chain, seal
from common.log.segment_writer import Attachments, Compression, Metadata, SegmentWriter
from common.log.segments import list_segments, segment_number, segment_path
from common.log.signatures import Signer
from common.log.totals import METADATA as TOTALS
from common.log.totals import Totals

Message = tuple[str, int, bytes]
"""Topic, time in nanoseconds, data."""


class SegmentSequence:
    """Appends groups of messages to the segments of a directory, beginning with a new one; used by one thread.

    Every method raises OSError. After one the sequence must be closed with `abandon`.

    Args:
        segment_bytes, segment_messages: size from which on a segment is full.
        metadata: put at the start of every segment.
        attachments: put into the first segment, with `repeat_attachments` into every one.
        chain, signer, totals: as `LogWriter` has them.
    """

    def __init__(
        self,
        directory: Path,
        *,
        segment_bytes: int,
        segment_messages: int,
        compression: Compression,
        clock_ns: Callable[[], int],
        metadata: Metadata,
        attachments: Attachments,
        repeat_attachments: bool,
        chain: Chain | None,
        signer: Signer | None,
        totals: Totals | None,
    ) -> None:
        self._directory = directory
        self._segment_bytes = segment_bytes
        self._segment_messages = segment_messages
        self._compression = compression
        self._clock_ns = clock_ns
        self._metadata = dict(metadata)
        self._later_attachments = attachments if repeat_attachments else {}
        self._chain = chain
        self._signer = signer
        self._totals = totals
        present = list_segments(directory)
        self._number = 1 + (segment_number(present[-1]) or 0) if present else 0
        self._segment = self._open(attachments)
        self.synced_s = time.monotonic()
        """When all that was written was last synced."""

    @property
    def path(self) -> Path:
        """The file that is written now."""
        return self._segment.path

    def append(self, messages: Iterable[Message]) -> None:
        """Write a group and hand it to the operating system: it outlives the process."""
        if self._is_full():
            self._segment.finish()
            self.synced_s = time.monotonic()
            self._number += 1
            self._segment = self._open(self._later_attachments)
        for topic, t_ns, data in messages:
            self._add(topic, t_ns, data)
        self._segment.commit()

    def sync(self) -> None:
        """Make what was appended survive a loss of power."""
        self._segment.sync()
        self.synced_s = time.monotonic()

    def finish(self) -> None:
        """Seal the chain, where there is one, and finish the file."""
        if self._chain is not None:
            self._add("/seal", self._clock_ns(), b"{}")
        self._segment.finish()

    def abandon(self) -> None:
        """Cut the file back to the last group that was appended, and close it."""
        self._segment.abandon()

    def _add(self, topic: str, t_ns: int, data: bytes) -> None:
        if self._chain is not None:
            if topic in SEALED:
                data = seal(data, self._chain, self._signer)
            self._chain.add(topic, t_ns, data)
        if self._totals is not None:
            self._totals.add(topic, t_ns, data)
        self._segment.add(topic, t_ns, data)

    def _is_full(self) -> bool:
        # Metadata alone may exceed the size: without a message in each, segments would be rolled for ever.
        messages, size = self._segment.messages, self._segment.size
        return messages > 0 and (size >= self._segment_bytes or messages >= self._segment_messages)

    def _open(self, attachments: Attachments) -> SegmentWriter:
        metadata = dict(self._metadata)
        if self._totals is not None:
            metadata[TOTALS] = self._totals.metadata()
        if self._chain is not None:
            metadata[METADATA] = {"start": self._chain.digest}
            self._chain.begin_segment(metadata, attachments)
        return SegmentWriter(
            segment_path(self._directory, self._number),
            compression=self._compression,
            metadata=metadata,
            attachments=attachments,
            t_ns=self._clock_ns(),
        )
