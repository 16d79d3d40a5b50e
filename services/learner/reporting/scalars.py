"""Numbers by environment step as TensorBoard event files."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event
from tensorboardX.summary import hparams, scalar

from services.learner.reporting.trackers import Tracker

_LENGTH_BYTES = 8
_CRC_BYTES = 4


class Scalars:
    """Event files in a folder; TensorBoard shows the folders of many runs side by side.

    A curve never goes back: a point at a step that its curve has reached is left out, whoever drew that. So the points
    that a resumed run, or a second evaluator, makes a second time are drawn once.

    Curves are for looking at, and the log has the same numbers: where they cannot be written they end with one call of
    `warn`, while the run goes on.

    `trackers` get the same points.
    """

    # tensorboardX's own `SummaryWriter` writes from a thread; when that meets a full disk it dies, and its callers
    # wait for ever for room in its queue.

    def __init__(
        self, folder: Path, warn: Callable[[str], None] = lambda text: None, trackers: Sequence[Tracker] = ()
    ) -> None:
        self._folder = folder
        self._trackers = trackers
        self._warn = warn
        self._writer: EventsWriter | None = None
        self._reached: dict[str, int] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._reached = _newest_steps(folder)
            self._writer = EventsWriter(str(folder / "events"), f".{os.getpid()}")
        except OSError as error:
            self._end(error)

    def reached(self, name: str) -> int:
        """The newest step of a curve; -1 where it has no point."""
        return self._reached.get(name, -1)

    def add(self, env_steps: int, values: Mapping[str, float | None]) -> None:
        """One value a name at this many environment steps; None is left out."""
        event = Event(step=env_steps, wall_time=time.time())
        drawn = {name: value for name, value in values.items() if value is not None and env_steps > self.reached(name)}
        for name, value in drawn.items():
            event.summary.value.extend(scalar(name, value).value)
            self._reached[name] = env_steps
        if drawn:
            self._write(event)
            for tracker in self._trackers:
                tracker.add(env_steps, drawn)

    def add_settings(self, settings: Mapping[str, object], curves: list[str]) -> None:
        """Settings by name for TensorBoard's HPARAMS tab, which compares runs by the newest points of `curves`."""
        for summary in hparams(dict(settings), dict.fromkeys(curves)):
            self._write(Event(summary=summary, wall_time=time.time()))

    def flush(self) -> None:
        """Write what is held back, so that it can be looked at."""
        if self._writer is None:
            return
        try:
            self._writer.flush()
        except OSError as error:
            self._end(error)

    def close(self) -> None:
        """Write what is held back. Does nothing the second time."""
        for tracker in self._trackers:
            tracker.close()
        if self._writer is None:
            return
        try:
            self._writer.close()
        except OSError as error:
            self._end(error)
        self._writer = None

    def _write(self, event: Event) -> None:
        if self._writer is None:
            return
        try:
            self._writer.write_event(event)
        except OSError as error:
            self._end(error)

    def _end(self, error: OSError) -> None:
        if self._writer is not None:
            # Its own `close` first writes what is held back, and where that fails leaves the file open.
            with contextlib.suppress(OSError):
                self._writer._py_recordio_writer.close()
        self._writer = None
        self._warn(f"the curves in {self._folder} end here: {error.strerror}; the log has all numbers")


def _newest_steps(folder: Path) -> dict[str, int]:
    """The newest step of every curve in a folder's event files."""
    newest: dict[str, int] = {}
    for path in sorted(folder.glob("events.out.tfevents.*")):
        for event in _events(path.read_bytes()):
            for value in event.summary.value:
                newest[value.tag] = max(event.step, newest.get(value.tag, -1))
    return newest


def _events(data: bytes) -> Iterator[Event]:
    """The events of a file, up to the first that is incomplete, as after a kill, or damaged."""
    start = 0
    while True:
        begin = start + _LENGTH_BYTES + _CRC_BYTES
        end = begin + int.from_bytes(data[start : start + _LENGTH_BYTES], "little")
        if end + _CRC_BYTES > len(data) or end == begin:
            return
        event = Event()
        try:
            event.ParseFromString(data[begin:end])
        except ValueError:  # protobuf's DecodeError
            return
        yield event
        start = end + _CRC_BYTES
