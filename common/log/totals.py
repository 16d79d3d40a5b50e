"""Running totals of a log: named by every segment, so that the log can be read from there on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

METADATA = "before"
"""Name of the metadata at the beginning of a segment that holds the totals of all segments before it."""


class Totals(Protocol):
    """Follows the messages of a log in the order in which they are written; used by the writer's thread alone."""

    def add(self, topic: str, t_ns: int, data: bytes) -> None:
        """Count a message."""
        ...

    def metadata(self) -> Mapping[str, str]:
        """The totals of all messages so far."""
        ...
