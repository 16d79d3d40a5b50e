"""The reader of a run's log: every message, in the order it was written, or an error that says where it stops."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from common.errors import LogReadError
from common.log.chain import ChainCheck
from common.log.framing import TornTail
from common.log.records import CHANNELS, LogMessage
from common.log.segment_reader import SegmentReader
from common.log.segments import find_segments
from common.suggestions import unknown_name

__all__ = ["LogMessage", "LogReader", "TornTail"]


class LogReader:
    """Reads the log of a run as it was when this object was made, also while a learner is writing it.

    Args:
        path: a run directory, its log directory, or one .mcap file.

    Raises:
        LogReadError: there is no log, or a segment between two others is missing.
    """

    def __init__(self, path: Path) -> None:
        self._segments = [SegmentReader(segment) for segment in find_segments(path)]

    def messages(self, topics: Collection[str] | None = None, chain: ChainCheck | None = None) -> Iterator[LogMessage]:
        """The messages in the order they were written, segment after segment; all topics if None.

        Holds one chunk in memory at a time. `chain` follows all messages, whatever the topics. Segments without a
        footer give the messages of their complete chunks; `torn` says which those are.

        Raises:
            LogReadError: there is no such topic; or, from the iterator, something is damaged. All messages given
                out before that are good.
        """
        for topic in topics or ():
            if topic not in CHANNELS:
                raise LogReadError(unknown_name("topic of the log", topic, CHANNELS))
        if chain is None:
            return (message for segment in self._segments for message in segment.messages(topics))
        return (message for message in self._chained(chain) if topics is None or message.topic in topics)

    def _chained(self, chain: ChainCheck) -> Iterator[LogMessage]:
        for segment in self._segments:
            chain.begin_segment(segment.path, segment.metadata(), segment.attachments())
            for message in segment.messages():
                chain.read(message)
                yield message

    @property
    def torn(self) -> list[TornTail]:
        """The segments without a footer, and how much of each is good.

        Raises:
            LogReadError: the framing is damaged.
        """
        return [segment.torn for segment in self._segments if segment.torn is not None]

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata by name. Where a resumed run changed it, that of the newest segment."""
        merged: dict[str, dict[str, str]] = {}
        for segment in self._segments:
            merged |= segment.metadata()
        return merged

    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """The attachments: name -> (media type, content). Where a resumed run changed one, the newest."""
        merged: dict[str, tuple[str, bytes]] = {}
        for segment in self._segments:
            merged |= segment.attachments()
        return merged

    def counts(self) -> dict[str, int]:
        """Messages by topic, without the topics that have none. Unfinished segments are read for it."""
        total: Counter[str] = Counter()
        for segment in self._segments:
            total.update(segment.counts())
        return dict(total)
