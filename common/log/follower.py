"""The follower of a log that grows: each message once, without reading again what was read before."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from common.errors import LogReadError
from common.log.framing import damaged
from common.log.records import LogMessage
from common.log.segment_reader import SegmentReader
from common.log.segments import find_segments


@dataclass
class _Position:
    """The place in one segment up to which it was read."""

    path: Path
    offset: int = 0
    count: int = 0
    size: int = -1
    """Of the file when all of it had been read."""
    names: dict[int, str] = field(default_factory=dict)


class LogFollower:
    """Reads the log of a run directory while it grows, also over the death and the resumption of its learner.

    Args:
        path: a run directory; its log need not be there yet.
        topics: of the messages that are wanted.
    """

    def __init__(self, path: Path, topics: Collection[str]) -> None:
        self._path = path
        self._topics = frozenset(topics)
        self._at: _Position | None = None

    def read(self, most: int) -> list[LogMessage]:
        """The next messages, somewhat more than `most` if there are so many; none where nothing was added.

        Raises:
            LogReadError: something is damaged, or what was read before is no longer there. The follower is of no use
                then.
        """
        found: list[LogMessage] = []
        while (at := self._at or self._first()) is not None and len(found) < most:
            self._at = at
            following = self._following(at)
            if not self._advance(at, found, most) and following is None:
                break
            if len(found) < most and following is not None:
                self._at = _Position(following)
        return found

    def _advance(self, at: _Position, found: list[LogMessage], most: int) -> bool:
        """Read on in the segment; False where it has no more for now."""
        if not at.path.exists() and self._following(at) is not None:
            return False  # a run may keep the newest segments alone
        segment = SegmentReader(at.path, at.offset)
        if segment.size < at.offset:
            raise damaged(at.path, segment.size, "it became shorter than it was when it was last read")
        if segment.size == at.size:
            return False
        advanced = False
        for offset, messages in segment.chunks(at.names, at.count):
            at.offset, at.count, advanced = offset, at.count + len(messages), True
            found += [message for message in messages if message.topic in self._topics]
            if len(found) >= most:
                return True
        at.size = segment.size
        return advanced

    def _first(self) -> _Position | None:
        try:
            return _Position(find_segments(self._path)[0])
        except LogReadError:
            if any((self._path / "log").glob("*.mcap")):
                raise
            return None

    def _following(self, at: _Position) -> Path | None:
        """The segment after this one. Looked up before this one is read: it is complete once there is another."""
        return next((path for path in find_segments(self._path) if path.name > at.path.name), None)
