"""The log of an interrupted run as an index: read once, whole, before the run is resumed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.errors import LogReadError
from common.log.chain import ChainCheck
from common.log.reader import LogReader
from common.log.records import LogMessage
from common.log.segments import find_segments
from common.runs.recorded_updates import TOPICS, RecordedUpdate, read_updates
from common.wire.messages import Environment, Snapshot
from common.wire.rollout import Rollout, RolloutId
from services.learner.reporting.evaluations import is_of_the_run

UNUSED_UPDATES = 2
"""Rollouts that no update has used yet lie after the last update but one; in async mode, but one more by staleness."""


@dataclass(frozen=True)
class UpdateEntry:
    """One `/update` without its rollouts: digest of the state it led to, and the places of the rollouts it used."""

    digest: str
    places: tuple[RolloutId, ...]


@dataclass
class LoggedRun:
    """The records of a log that decide how a run goes on.

    Attributes:
        updates: by the version they led to.
        unused: rollouts that no update has used, of the last version or as little behind it as the run's staleness
            allows, and of the next; in their order.
        episodes: the `/episode` records.
        environments: (version, slot, generation) of the environment states in the log.
        ahead: (topic, version) of records beyond the last update.
        set_aside: places of the rollouts that were set aside, by the version that they would have updated.
        first_version: version of the first update in each segment; None where it has none.
        chain: of the whole log.
    """

    run_dir: Path
    settings: RunSettings
    segments: list[Path]
    updates: dict[int, UpdateEntry] = field(default_factory=dict)
    unused: list[Rollout] = field(default_factory=list)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    environments: set[tuple[int, int, int]] = field(default_factory=set)
    ahead: set[tuple[str, int]] = field(default_factory=set)
    first_version: list[int | None] = field(default_factory=list)
    set_aside: dict[int, set[RolloutId]] = field(default_factory=dict)
    chain: ChainCheck = field(default_factory=ChainCheck)

    @property
    def last(self) -> int:
        """Version of the last update, 0 where there is none."""
        return max(self.updates, default=0)

    def places(self, after: int) -> list[tuple[RolloutId, ...]]:
        """Places of the rollouts of every update after that version.

        Raises:
            LogReadError: the log lacks one of them.
        """
        versions = range(after + 1, self.last + 1)
        if missing := [version for version in versions if version not in self.updates]:
            raise LogReadError(f"the log {self.segments[0].parent} lacks update {missing[0]}; restore it from a copy")
        return [self.updates[version].places for version in versions]

    def updates_after(self, version: int) -> Iterator[RecordedUpdate]:
        """The updates after that version with their rollouts, read as they are asked for."""
        # Records of version v are not written before the update to v - 1; rollouts, before that to v - 1 - S.
        oldest = version - self.settings.staleness
        early = [n for n, first in enumerate(self.first_version) if first is not None and first < oldest]
        readers = [LogReader(path) for path in self.segments[max(early, default=0) :]]
        messages = chain.from_iterable(reader.messages(TOPICS) for reader in readers)
        return read_updates(messages, self.run_dir, self.settings, after=version)


def read_logged_run(run_dir: Path, settings: RunSettings) -> LoggedRun:
    """Read the log of a run with these settings.

    Raises:
        LogReadError: there is none, or it is damaged.
        CodecError: a message of it does not fit its channel.
    """
    found = LoggedRun(run_dir, settings, find_segments(run_dir))
    newest: dict[str, LogMessage] = {}
    # Those of one version lie among (S + 1) K that came before it was used up and (S + 1) K that came after.
    rollouts: deque[bytes] = deque(maxlen=(UNUSED_UPDATES + 1 + 2 * settings.staleness) * settings.actors)
    for path in found.segments:
        first: int | None = None
        for message in LogReader(path).messages(chain=found.chain):
            if message.topic != "/eval" or is_of_the_run(message.json()):
                newest[message.topic] = message
            if message.topic == "/rollout":
                rollouts.append(message.data)
            elif message.topic == "/update":
                version = _add_update(found, message.json())
                first = version if first is None else first
            elif message.topic == "/set_aside":
                record = message.json()
                found.set_aside.setdefault(int(record["version"]), set()).update(_places(record))
            elif message.topic == "/episode":
                found.episodes.append(message.json())
            elif message.topic == "/environment":
                kept = Environment.decode(message.data)
                found.environments.add((kept.version, kept.slot, kept.generation))
        found.first_version.append(first)
    found.unused = _unused(found, rollouts)
    found.ahead = _ahead(found.last, newest)
    return found


def _add_update(found: LoggedRun, record: dict[str, Any]) -> int:
    version = int(record["version"])
    found.updates[version] = UpdateEntry(record["state_digest"], _places(record))
    return version


def _places(record: dict[str, Any]) -> tuple[RolloutId, ...]:
    return tuple(RolloutId(used["slot"], used["generation"], used["seq"]) for used in record["rollouts"])


def _unused(found: LoggedRun, rollouts: deque[bytes]) -> list[Rollout]:
    """The rollouts that the updates after the last one may use, out of the newest of the log."""
    last, oldest = found.last, found.last - found.settings.staleness
    used = {
        place
        for version in range(oldest - UNUSED_UPDATES, last + 1)
        if version in found.updates
        for place in found.updates[version].places
    }
    used.update(*found.set_aside.values())
    decoded = [Rollout.decode(data) for data in rollouts]
    # The next version is published, and acted by, before the update to it is recorded.
    return [made for made in decoded if made.policy_version >= oldest and made.id not in used]


def _ahead(last: int, newest: dict[str, LogMessage]) -> set[tuple[str, int]]:
    """(topic, version) of records that were written ahead of their update, or after the last one."""
    versions: dict[str, int] = {
        topic: newest[topic].json()["version"] for topic in ("/episode", "/eval") if topic in newest
    }
    if "/policy" in newest:
        versions["/policy"] = Snapshot.decode(newest["/policy"].data).version
    return {(topic, version) for topic, version in versions.items() if version > last or topic == "/eval"}
