"""Updates with the rollouts they used, joined out of the `/rollout` and `/update` messages of a log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.errors import CodecError, LogReadError
from common.log.records import LogMessage
from common.runs.rollout_shape import rollout_shape
from common.runs.rollout_window import RolloutWindow
from common.wire.codec import Limits
from common.wire.rollout import Rollout, RolloutShape

TOPICS = ("/rollout", "/update")

LIMITS = Limits(max_message=1 << 32, max_bin=1 << 32)


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


class UpdateReader:
    """Joins the messages of a log, given one by one and in order, to updates.

    Args:
        path: of the log, for errors.
        after: version of the last update that is not wanted: it and those before it are passed over, and may name
            rollouts that were never given.
        on_unused: called with each rollout that no update used, once that is certain: some time after its place in
            the log.
    """

    def __init__(
        self, path: Path, settings: RunSettings, *, after: int = 0, on_unused: Callable[[Rollout], None] | None = None
    ) -> None:
        self._path = path
        self._shape = rollout_shape(settings)
        self._window = RolloutWindow(settings.actors, on_unused or _ignore)
        self._after = after
        self._version = 0

    def read(self, message: LogMessage) -> RecordedUpdate | Rollout | None:
        """The content of a message; None where it is of another topic, or an update that is passed over.

        Raises:
            LogReadError: the message cannot be read, a rollout that an update names was not given before it, or the
                versions do not follow each other.
        """
        if message.topic == "/rollout":
            rollout = _read_rollout(message, self._shape)
            self._window.add(rollout)
            return rollout
        return self._read_update(message) if message.topic == "/update" else None

    def close(self) -> None:
        """End of the log: what is left of the rollouts was not used."""
        self._window.close()

    def _read_update(self, message: LogMessage) -> RecordedUpdate | None:
        content = message.json()
        try:
            version = int(content["version"])
            keys = [(int(used["slot"]), str(used["incarnation"]), int(used["seq"])) for used in content["rollouts"]]
            self._check_order(version)
            if version <= self._after:
                self._window.discard(keys)
                return None
            return RecordedUpdate(
                version=version,
                env_steps=int(content["env_steps"]),
                rollouts=self._window.take(version, keys),
                state_digest=str(content["state_digest"]),
                metrics=_numbers(content["metrics"]),
                seconds=_numbers(content["seconds"]),
                staleness=_numbers(content["staleness"]),
                t_ns=message.t_ns,
                data=message.data,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise LogReadError(
                f"message {message.sequence} of /update is not the record of an update ({error!r}); read this log "
                "with the version that wrote it"
            ) from None

    def _check_order(self, version: int) -> None:
        if self._version and version != self._version + 1:
            raise LogReadError(
                f"{self._path}: update {version} comes after update {self._version}; a part of the log is missing or "
                "there twice"
            )
        self._version = version


def read_updates(
    messages: Iterable[LogMessage], path: Path, settings: RunSettings, *, after: int = 0
) -> Iterator[RecordedUpdate]:
    """The updates to versions beyond `after` out of `/rollout` and `/update` messages, read as they are asked for.

    Raises (from the iterator):
        LogReadError: as `UpdateReader.read`.
    """
    reader = UpdateReader(path, settings, after=after)
    for message in messages:
        content = reader.read(message)
        if isinstance(content, RecordedUpdate):
            yield content


def _read_rollout(message: LogMessage, shape: RolloutShape) -> Rollout:
    try:
        rollout = Rollout.decode(message.data, LIMITS)
        rollout.check(shape)
    except CodecError as error:
        raise LogReadError(f"message {message.sequence} of /rollout is not a rollout of this run: {error}") from None
    return rollout


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values, which are numbers, or null where one was not finite. TypeError where one is something else."""
    for name, value in values.items():
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise TypeError(f"{name[:100]} is {type(value).__name__}, not a number")
    return dict(values)


def _ignore(_: Rollout) -> None:
    """Takes the unused rollouts where no caller asks for them."""
