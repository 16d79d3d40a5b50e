"""A recorded run, read back from its log alone: settings, where it was made, and every update with its rollouts."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.config.sources import parse_json
from common.errors import CodecError, LogReadError
from common.log.reader import LogMessage, LogReader, TornTail
from common.log.segments import find_segments
from common.runs.rollout_shape import rollout_shape
from common.runs.window import Window
from common.wire.codec import Limits
from common.wire.messages import Rollout, RolloutShape

_LIMITS = Limits(max_message=1 << 32, max_bin=1 << 32)


@dataclass(frozen=True, eq=False)
class RecordedUpdate:
    """One update as it was logged, with the rollouts it was made from, in the order of use.

    `version` is the one that resulted and `state_digest` that of its state; `env_steps` counts from the start of the
    run; `seconds` is by phase; a metric is None where it was not finite; `t_ns` is the Unix time of logging, and
    `data` the message as it was written.
    """

    version: int
    env_steps: int
    rollouts: list[Rollout]
    state_digest: str
    metrics: Mapping[str, float | None]
    seconds: Mapping[str, float]
    staleness: Mapping[str, float]
    t_ns: int
    data: bytes


class RecordedRun:
    """The log of a run as it was when this object was made. Nothing of it is kept in memory but what is in use.

    Args:
        path: a run directory, its log directory, or one .mcap file.

    Raises:
        LogReadError: there is no log, it is damaged, or it does not begin with the run's settings.
        SettingsError: this version has no such settings.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._reader = LogReader(path)
        self._spec = self._read_spec()
        self.run: str = str(self._spec["run"])
        self.settings: RunSettings = parse_json(json.dumps(self._spec["settings"]))

    @property
    def torn(self) -> list[TornTail]:
        """The segments without an end: of a run that was killed, or goes on."""
        return self._reader.torn

    def origins(self) -> list[dict[str, str]]:
        """Where each segment was made: commit, versions and hardware in one map, as `origin` makes it."""
        found = []
        for segment in find_segments(self.path):
            metadata = LogReader(segment).metadata()
            found.append(
                origin(
                    metadata.get("run", {}).get("commit", "unknown"),
                    metadata.get("versions", {}),
                    metadata.get("hardware", {}),
                )
            )
        return found

    def count_updates(self) -> int:
        """Updates in the log. Unfinished segments are read for it."""
        return self._reader.counts().get("/update", 0)

    def updates(
        self, *, until: int | None = None, on_unused: Callable[[Rollout], None] | None = None
    ) -> Iterator[RecordedUpdate]:
        """The updates in order, read as they are asked for.

        Args:
            until: the last version wanted; None for all.
            on_unused: called with each rollout that no update used: one that came too late, or after the last update.
                It is called once that is certain, so some time after the rollout's place in the log; not at all for
                what is left over at `until`.

        Raises (from the iterator):
            LogReadError: the log is damaged, a rollout that an update names is not in the log before it, or the
                versions do not follow each other.
        """
        for _, content in self._walk(("/rollout", "/update"), on_unused or _ignore):
            if isinstance(content, RecordedUpdate):
                yield content
                if content.version == until:
                    return

    def messages(self) -> Iterator[tuple[LogMessage, RecordedUpdate | Rollout | None]]:
        """Every message of the log as it was written, and what it says where it is one of /rollout or /update.

        Raises (from the iterator):
            LogReadError: as `updates`.
        """
        return self._walk(None, _ignore)

    def _walk(
        self, topics: Collection[str] | None, on_unused: Callable[[Rollout], None]
    ) -> Iterator[tuple[LogMessage, RecordedUpdate | Rollout | None]]:
        window = Window(self.settings.actors, on_unused)
        shape = rollout_shape(self.settings)
        version = 0
        for message in self._reader.messages(topics):
            content: RecordedUpdate | Rollout | None = None
            if message.topic == "/rollout":
                content = _read_rollout(message, shape)
                window.add(content)
            elif message.topic == "/update":
                content = update = _read_update(message, window)
                if version and update.version != version + 1:
                    raise LogReadError(
                        f"{self.path}: update {update.version} comes after update {version}; a part of the log is "
                        "missing or there twice"
                    )
                version = update.version
            yield message, content
        window.end()

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


def origin(commit: str, versions: Mapping[str, str], hardware: Mapping[str, str]) -> dict[str, str]:
    """Commit, versions and hardware in one map, so that two of them can be compared name by name."""
    return {"commit": commit, **versions, **hardware}


def _read_rollout(message: LogMessage, shape: RolloutShape) -> Rollout:
    try:
        rollout = Rollout.decode(message.data, _LIMITS)
        rollout.check(shape)
    except CodecError as error:
        raise LogReadError(f"message {message.sequence} of /rollout is not a rollout of this run: {error}") from None
    return rollout


def _read_update(message: LogMessage, window: Window) -> RecordedUpdate:
    content = message.json()
    try:
        version = int(content["version"])
        keys = [(int(used["slot"]), str(used["incarnation"]), int(used["seq"])) for used in content["rollouts"]]
        return RecordedUpdate(
            version=version,
            env_steps=int(content["env_steps"]),
            rollouts=window.take(version, keys),
            state_digest=str(content["state_digest"]),
            metrics=dict(content["metrics"]),
            seconds=dict(content["seconds"]),
            staleness=dict(content["staleness"]),
            t_ns=message.t_ns,
            data=message.data,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise LogReadError(
            f"message {message.sequence} of /update is not the record of an update ({error!r}); read this log with "
            "the version that wrote it"
        ) from None


def _ignore(_: Rollout) -> None:
    """What becomes of a rollout without use where nobody asks for it."""
