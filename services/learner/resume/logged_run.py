"""What the log of an interrupted run says of it: read once, whole, before the run is resumed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from common.errors import LogReadError
from common.log.reader import LogReader
from common.log.records import LogMessage
from common.log.segments import find_segments
from common.wire.messages import Environment, Rollout, Snapshot
from services.learner.reporting.evaluations import is_of_the_run
from services.learner.resume.tail import LoggedUpdate, place_of, read_updates
from services.learner.scheduling.slots import Place

UNUSED_UPDATES = 2
"""Rollouts that no update has used yet lie after the last update but one; in async mode, but one more by staleness."""


@dataclass(frozen=True)
class UpdateEntry:
    """One `/update` without its rollouts: digest of the state it led to, and the places of what it used."""

    digest: str
    places: tuple[Place, ...]


@dataclass
class LoggedRun:
    """The records of a log that decide how a run goes on.

    Attributes:
        updates: by the version they led to.
        staleness: versions that a rollout may lie behind the policy that it updates.
        unused: rollouts that no update has used, of the last version or as little behind it as that, and of the next;
            in their order.
        episodes: the `/episode` records.
        environments: (version, slot, generation) of the environment states in the log.
        ahead: (topic, version) of records beyond the last update.
    """

    segments: list[Path]
    staleness: int = 0
    updates: dict[int, UpdateEntry] = field(default_factory=dict)
    unused: list[Rollout] = field(default_factory=list)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    environments: set[tuple[int, int, int]] = field(default_factory=set)
    ahead: set[tuple[str, int]] = field(default_factory=set)
    first_version: list[int | None] = field(default_factory=list)
    """Version of the first update in each segment; None where it has none."""

    @property
    def last(self) -> int:
        """Version of the last update, 0 where there is none."""
        return max(self.updates, default=0)

    def places(self, after: int) -> list[tuple[Place, ...]]:
        """Places of the rollouts of every update after that version.

        Raises:
            LogReadError: the log lacks one of them.
        """
        versions = range(after + 1, self.last + 1)
        if missing := [version for version in versions if version not in self.updates]:
            raise LogReadError(f"the log {self.segments[0].parent} lacks update {missing[0]}; restore it from a copy")
        return [self.updates[version].places for version in versions]

    def updates_after(self, version: int) -> Iterator[LoggedUpdate]:
        """The updates after that version with their rollouts, read as they are asked for."""
        # What belongs to version v is not written before the update to v - 1; rollouts, before that to v - 1 - S.
        oldest = version - self.staleness
        early = [n for n, first in enumerate(self.first_version) if first is not None and first < oldest]
        readers = [LogReader(path) for path in self.segments[max(early, default=0) :]]
        messages = chain.from_iterable(reader.messages(["/rollout", "/update"]) for reader in readers)
        return read_updates(messages, version, self.staleness)


def read_logged_run(run_dir: Path, slots: int, staleness: int = 0) -> LoggedRun:
    """Read the log of a run of so many slots, with rollouts as stale as that.

    Raises:
        LogReadError: there is none, or it is damaged.
        CodecError: a message of it is not what its channel holds.
    """
    found = LoggedRun(find_segments(run_dir), staleness)
    newest: dict[str, LogMessage] = {}
    # Those of one version lie among (S + 1) K that came before it was used up and (S + 1) K that came after.
    rollouts: deque[bytes] = deque(maxlen=(UNUSED_UPDATES + 1 + 2 * staleness) * slots)
    for path in found.segments:
        first: int | None = None
        for message in LogReader(path).messages():
            if message.topic != "/eval" or is_of_the_run(message.json()):
                newest[message.topic] = message
            if message.topic == "/rollout":
                rollouts.append(message.data)
            elif message.topic == "/update":
                version = _add_update(found, message.json())
                first = version if first is None else first
            elif message.topic == "/episode":
                found.episodes.append(message.json())
            elif message.topic == "/environment":
                kept = Environment.decode(message.data)
                found.environments.add((kept.version, kept.slot, kept.generation))
        found.first_version.append(first)
    _look_beyond(found, newest, rollouts)
    return found


def _add_update(found: LoggedRun, record: dict[str, Any]) -> int:
    version = int(record["version"])
    found.updates[version] = UpdateEntry(record["state_digest"], tuple(place_of(used) for used in record["rollouts"]))
    return version


def _look_beyond(found: LoggedRun, newest: dict[str, LogMessage], rollouts: deque[bytes]) -> None:
    last, oldest = found.last, found.last - found.staleness
    used = {place for version in range(oldest - UNUSED_UPDATES, last + 1) for place in _places(found, version)}
    decoded = [Rollout.decode(data) for data in rollouts]
    # The next version is published, and acted by, before the update to it is recorded.
    found.unused = [made for made in decoded if made.policy_version >= oldest and made.place not in used]
    versions: dict[str, int] = {
        topic: newest[topic].json()["version"] for topic in ("/episode", "/eval") if topic in newest
    }
    if "/policy" in newest:
        versions["/policy"] = Snapshot.decode(newest["/policy"].data).version
    found.ahead = {(topic, version) for topic, version in versions.items() if version > last or topic == "/eval"}


def _places(found: LoggedRun, version: int) -> tuple[Place, ...]:
    entry = found.updates.get(version)
    return () if entry is None else entry.places
