"""A recorded run, read from its log alone: its settings, where it was made, and every update with its rollouts."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from common.config.settings import RunSettings
from common.config.sources import parse_json
from common.errors import CodecError, LogReadError
from common.log.chain import ChainCheck
from common.log.reader import LogMessage, LogReader, TornTail
from common.log.segments import find_segments
from common.runs.initial_state import read_initial_state
from common.runs.needed_segments import read_tally
from common.runs.origins import origin
from common.runs.recorded_updates import LIMITS, TOPICS, RecordedUpdate, UpdateReader
from common.wire.messages import Snapshot
from common.wire.rollout import Rollout


class RecordedRun:
    """The log of a run as it was when this object was made. Only what is in use is kept in memory.

    Args:
        path: a run directory, its log directory, or one .mcap file.

    Raises:
        LogReadError: there is no log, it is damaged, or it does not begin with the run's settings.
        SettingsError: this version has no such settings.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._reader = LogReader(path)
        self.before = read_tally(find_segments(path)[0], updates=1)
        spec = self._read_spec() if self.whole else self._read_metadata()
        self.run: str = str(spec["run"])
        self.settings: RunSettings = parse_json(json.dumps(spec["settings"]))

    @property
    def whole(self) -> bool:
        """True if the log has its beginning; `before` has the totals of what was removed."""
        return not self.before.began_ns

    @property
    def first(self) -> int:
        """Version of the first update whose rollouts are all in the log."""
        # Update u uses rollouts of u - 1 - staleness, which are not written before the update to the version before it.
        # Of those after `before.version`, the log has what was written after the next update for certain.
        return 1 if self.whole else self.before.version + self.settings.staleness + 3

    @property
    def newest(self) -> int:
        """Version of the last update; 0 where there is none. Unfinished segments are read for it."""
        return self.before.version + self._reader.counts().get("/update", 0)

    def newest_settings(self) -> RunSettings:
        """The settings, with those that a resumption has changed."""
        text = self.metadata().get("settings", {}).get("json")
        return self.settings if text is None else parse_json(text)

    @property
    def torn(self) -> list[TornTail]:
        """The segments without a footer: of a run that was killed, or is still running."""
        return self._reader.torn

    def origins(self) -> list[dict[str, str]]:
        """The origin of each segment: commit, versions and hardware in one map, as `origin` makes it."""
        found = []
        for segment in find_segments(self.path):
            metadata = LogReader(segment).metadata()
            found.append(
                origin(
                    metadata.get("run", {}).get("commit", "unknown"),
                    metadata.get("versions", {}),
                    metadata.get("hardware", {}),
                    metadata.get("environment", {}),
                )
            )
        return found

    def initial_state(self) -> Mapping[str, np.ndarray] | None:
        """The learner's state before the first update; None where the settings decide it."""
        found = read_initial_state(self._reader)
        return None if found is None else found.arrays

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata by name, of the newest segment that has it."""
        return self._reader.metadata()

    def count_updates(self) -> int:
        """Updates in the log with all of their rollouts. Unfinished segments are read for it."""
        return max(0, self.newest - self.first + 1)

    def updates(
        self, *, after: int = 0, until: int | None = None, on_unused: Callable[[Rollout], None] | None = None
    ) -> Iterator[RecordedUpdate]:
        """The updates in order, from `first` on, read as they are asked for.

        Args:
            after: the last version that is not wanted.
            until: the last version wanted; None for all.
            on_unused: called with each rollout that no update used: one that came too late, or after the last update.
                It is called once that is certain, so some time after the rollout's place in the log; not at all for
                what is left over at `until`.

        Raises (from the iterator):
            LogReadError: the log is damaged, a rollout that an update names is not in the log before it, or the
                versions do not follow each other.
        """
        for _, content in self._walk(TOPICS, on_unused, after=after):
            if isinstance(content, RecordedUpdate):
                yield content
                if content.version == until:
                    return

    def policies(self) -> Iterator[Snapshot]:
        """The policies in the log, in order of their versions: every `log.policy_every`-th and the last.

        Raises (from the iterator):
            LogReadError: the log is damaged.
        """
        for message in self._reader.messages(["/policy"]):
            try:
                yield Snapshot.decode(message.data, LIMITS)
            except CodecError as error:
                raise LogReadError(f"message {message.sequence} of /policy is not a policy: {error}") from None

    def records(self, topic: str) -> Iterator[Mapping[str, Any]]:
        """The messages of a JSON channel in the order of the log.

        Raises (from the iterator):
            LogReadError: the log is damaged, or there is no such channel.
        """
        return (message.json() for message in self._reader.messages([topic]))

    def evaluations(self) -> Iterator[Mapping[str, Any]]:
        """The `/eval` records in the order of the log: the run's own and those of evaluators.

        Raises (from the iterator):
            LogReadError: the log is damaged.
        """
        return self.records("/eval")

    def messages(
        self, chain: ChainCheck | None = None, *, after: int = 0
    ) -> Iterator[tuple[LogMessage, RecordedUpdate | Rollout | None]]:
        """Every message of the log as it was written, and its content where it is of /rollout or /update.

        `chain` follows them. Updates before `first`, and up to version `after`, have no content.

        Raises (from the iterator):
            LogReadError: as `updates`.
        """
        return self._walk(None, None, chain, after)

    def _walk(
        self,
        topics: Collection[str] | None,
        on_unused: Callable[[Rollout], None] | None,
        chain: ChainCheck | None = None,
        after: int = 0,
    ) -> Iterator[tuple[LogMessage, RecordedUpdate | Rollout | None]]:
        reader = UpdateReader(self.path, self.settings, after=max(after, self.first - 1), on_unused=on_unused)
        for message in self._reader.messages(topics, chain):
            yield message, reader.read(message)
        reader.close()

    def _read_metadata(self) -> dict[str, Any]:
        metadata = LogReader(find_segments(self.path)[0]).metadata()
        try:
            return {"run": metadata["run"]["run"], "settings": json.loads(metadata["settings"]["json"])}
        except (KeyError, ValueError, RecursionError) as error:
            raise LogReadError(f"{self.path}: the log does not say the settings of its run: {error!r}") from None

    def _read_spec(self) -> dict[str, Any]:
        message = next(self._reader.messages(["/spec"]), None)
        spec = None if message is None else message.json()
        if not isinstance(spec, dict) or not {"run", "settings"} <= spec.keys():
            raise LogReadError(
                f"{self.path}: the log has no /spec with the settings of its run; it is empty, or its first segment "
                "was removed"
            )
        return spec


def open_run(path: Path | str) -> RecordedRun:
    """The recorded run in `path`; see `RecordedRun`."""
    return RecordedRun(Path(path))
