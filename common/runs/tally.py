"""The totals of a run's log: what a run needs of the records before the segment from which it is read.

A learner puts them at the beginning of every segment. So a run is resumed from the segment that its newest checkpoint
needs, whatever the length of the log before that, and goes on where older segments were deleted.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Any, Self

from common.errors import LogReadError

RECENT_EPISODES = 200
"""Episodes that the shown return is a mean of, at least, once so many have ended."""


@dataclass(frozen=True, slots=True)
class Ended:
    """The episodes that ended in one update."""

    version: int
    count: int
    return_mean: float


def late_from(updates: int) -> int:
    """The first version of the last tenth of a run's updates."""
    return updates - max(1, updates // 10) + 1


class Tally:
    """Follows the records of a run.

    Args:
        updates: of the whole run.

    Attributes:
        version: of the newest update.
        episodes: all that ended.
        window: those that the mean returns of the run still depend on: the newest 200, and the last tenth's.
        generations: the newest generation of each slot whose rollouts were used or set aside.
        began_ns: time of the first record; 0 before it.
    """

    def __init__(self, updates: int) -> None:
        self.version = 0
        self.episodes = 0
        self.window: deque[Ended] = deque()
        self.generations: dict[int, int] = {}
        self.began_ns = 0
        self._late_from = late_from(updates)

    @classmethod
    def of(cls, metadata: Mapping[str, str], updates: int) -> Self:
        """The totals that a segment names.

        Raises:
            LogReadError: they are not such totals.
        """
        found = cls(updates)
        try:
            found.version, found.episodes = int(metadata["version"]), int(metadata["episodes"])
            found.began_ns = int(metadata["began_ns"])
            ended = [Ended(int(version), int(count), float(mean)) for version, count, mean in _list(metadata, "window")]
            found.window.extend(ended)
            found.generations = {int(slot): int(generation) for slot, generation in _list(metadata, "generations")}
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise LogReadError(f"a segment of the log names no totals of those before it: {error!r}") from None
        return found

    def metadata(self) -> dict[str, str]:
        """The totals so far, for the beginning of a segment."""
        return {
            "version": str(self.version),
            "episodes": str(self.episodes),
            "began_ns": str(self.began_ns),
            "window": json.dumps([astuple(ended) for ended in self.window], separators=(",", ":")),
            "generations": json.dumps(sorted(self.generations.items()), separators=(",", ":")),
        }

    @property
    def earlier_episodes(self) -> int:
        """Episodes that ended before those of the window."""
        return self.episodes - sum(ended.count for ended in self.window)

    def add(self, topic: str, t_ns: int, data: bytes) -> None:
        """Count a message."""
        self.began_ns = self.began_ns or t_ns
        if topic in ("/update", "/episode", "/set_aside"):
            self.count(topic, json.loads(data))

    def count(self, topic: str, record: Mapping[str, Any]) -> None:
        """Count a record of /update, /episode or /set_aside."""
        if topic == "/episode":
            self._end(Ended(int(record["version"]), int(record["count"]), float(record["return_mean"])))
            return
        if topic == "/update":
            self.version = int(record["version"])
        for used in record["rollouts"]:
            slot, generation = int(used["slot"]), int(used.get("generation", 0))
            self.generations[slot] = max(generation, self.generations.get(slot, 0))

    def _end(self, ended: Ended) -> None:
        self.episodes += ended.count
        self.window.append(ended)
        newest = sum(kept.count for kept in self.window)
        while self.window[0].version < self._late_from and newest - self.window[0].count >= RECENT_EPISODES:
            newest -= self.window.popleft().count


def _list(metadata: Mapping[str, str], name: str) -> list[Any]:
    content = json.loads(metadata[name])
    if not isinstance(content, list):
        raise TypeError(f"{name} is no list")
    return content
