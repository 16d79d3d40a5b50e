"""The log of an interrupted run as an index, read from the segment on that a checkpoint needs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.errors import CodecError, LogReadError
from common.log.chain import ChainCheck
from common.log.reader import LogReader
from common.log.records import LogMessage
from common.log.segments import find_segments
from common.runs.needed_segments import first_needed, read_tally
from common.runs.recorded_updates import TOPICS, RecordedUpdate, read_updates
from common.runs.tally import Tally
from common.wire.messages import Environment, Snapshot
from common.wire.rollout import Rollout, RolloutId
from services.learner.reporting.evaluations import is_of_the_run

UNUSED_UPDATES = 2
"""Rollouts that no update has used yet lie after the last update but one; in async mode, but one more by staleness."""

OnRead = Callable[[int, int], None]
"""Called with the bytes of the log that were read, and the bytes that are to be read."""


@dataclass(frozen=True)
class UpdateEntry:
    """One `/update` without its rollouts: digest of the state it led to, and the places of the rollouts it used."""

    digest: str
    places: tuple[RolloutId, ...]


@dataclass
class LoggedRun:
    """The records of a log that decide how a run goes on.

    Attributes:
        segments: those that were read: the newest of the log, up to its end.
        before: the totals of the segments before them.
        tally: the totals of the whole log.
        updates: by the version they led to.
        unused: rollouts that no update has used, of the last version or as little behind it as the run's staleness
            allows, and of the next; in their order.
        episodes: the `/episode` records; of those before the segments, the ones that mean returns still depend on.
        environments: (version, slot, generation) of the environment states in the log.
        ahead: (topic, version) of records beyond the last update.
        set_aside: places of the rollouts that were set aside, by the version that they would have updated.
        first_version: version of the first update in each segment; None where it has none.
        chain: of the log, followed from the first of the segments on.
    """

    run_dir: Path
    settings: RunSettings
    segments: list[Path]
    before: Tally
    tally: Tally
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
        return max(self.updates, default=self.before.version)

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


class LogIndexer:
    """Reads as much of a run's log as a version needs, and more only where an older version needs more.

    Args:
        on_read: as `OnRead`.

    Raises:
        LogReadError: there is no log.
    """

    def __init__(self, run_dir: Path, settings: RunSettings, on_read: OnRead | None = None) -> None:
        self._run_dir = run_dir
        self._settings = settings
        self._on_read = on_read or _ignore
        self._segments = find_segments(run_dir)
        self._first = len(self._segments)
        self._found: LoggedRun | None = None

    @property
    def skipped(self) -> int:
        """Segments that were not read."""
        return self._first

    def since(self, version: int) -> LoggedRun:
        """The log from the update to `version` on, or more of it; all that there is for 0.

        Raises:
            LogReadError: the log is damaged, or not as this release writes it.
        """
        try:
            first = first_needed(self._segments, version, self._settings.staleness) if version else 0
            if self._found is None or first < self._first:
                self._found = read_logged_run(self._run_dir, self._settings, self._segments[first:], self._on_read)
                self._first = first
        except (CodecError, KeyError, TypeError, ValueError) as error:
            raise LogReadError(
                f"the log in {self._run_dir} cannot be used: {error!r}; resume it with the release that wrote it"
            ) from None
        return self._found


def read_logged_run(run_dir: Path, settings: RunSettings, segments: list[Path], on_read: OnRead) -> LoggedRun:
    """Read these segments, the newest of the log of a run with these settings.

    Raises:
        LogReadError: one is damaged.
        CodecError: a message does not fit its channel.
    """
    before, tally = (read_tally(segments[0], settings.updates) for _ in range(2))
    found = LoggedRun(run_dir, settings, segments, before, tally)
    found.episodes = [asdict(ended) for ended in before.window]
    newest: dict[str, LogMessage] = {}
    # Those of one version lie among (S + 1) K that came before it was used up and (S + 1) K that came after.
    rollouts: deque[bytes] = deque(maxlen=(UNUSED_UPDATES + 1 + 2 * settings.staleness) * settings.actors)
    for path, message in _messages(found, on_read):
        if message.topic != "/eval" or is_of_the_run(message.json()):
            newest[message.topic] = message
        tally.began_ns = tally.began_ns or message.t_ns
        if message.topic == "/rollout":
            rollouts.append(message.data)
        elif message.topic == "/environment":
            kept = Environment.decode(message.data)
            found.environments.add((kept.version, kept.slot, kept.generation))
        elif message.topic in ("/update", "/set_aside", "/episode"):
            _add_record(found, message.topic, message.json(), segments.index(path))
    found.unused = _unused(found, rollouts)
    found.ahead = _ahead(found.last, newest)
    return found


def _messages(found: LoggedRun, on_read: OnRead) -> Iterator[tuple[Path, LogMessage]]:
    sizes = [path.stat().st_size for path in found.segments]
    for number, path in enumerate(found.segments):
        found.first_version.append(None)
        read = sum(sizes[:number])
        for message in LogReader(path).messages(chain=found.chain):
            # Compressed, a segment has more bytes of messages than of file.
            read = min(read + len(message.data), sum(sizes[: number + 1]))
            on_read(read, sum(sizes))
            yield path, message


def _add_record(found: LoggedRun, topic: str, record: dict[str, Any], segment: int) -> None:
    found.tally.count(topic, record)
    if topic == "/episode":
        found.episodes.append(record)
    elif topic == "/set_aside":
        found.set_aside.setdefault(int(record["version"]), set()).update(_places(record))
    else:
        version = int(record["version"])
        found.updates[version] = UpdateEntry(record["state_digest"], _places(record))
        if found.first_version[segment] is None:
            found.first_version[segment] = version


def _ignore(read: int, total: int) -> None:
    """Takes the progress where no caller asks for it."""


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
