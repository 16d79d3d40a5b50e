"""Numbers by environment step as TensorBoard event files."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event
from tensorboardX.summary import scalar


class Scalars:
    """Event files in a folder; TensorBoard shows the folders of many runs side by side.

    Curves are for looking at, and the log has the same numbers: where they cannot be written they end, and `warn` is
    told so, once, while the run goes on.
    """

    # tensorboardX's own `SummaryWriter` writes from a thread; when that meets a full disk it dies, and its callers
    # wait for ever for room in its queue.

    def __init__(self, folder: Path, warn: Callable[[str], None] = lambda text: None) -> None:
        self._folder = folder
        self._warn = warn
        self._writer: EventsWriter | None = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._writer = EventsWriter(str(folder / "events"), f".{os.getpid()}")
        except OSError as error:
            self._end(error)

    def add(self, env_steps: int, values: Mapping[str, float | None]) -> None:
        """One value a name at this many environment steps; None is left out."""
        if self._writer is None:
            return
        event = Event(step=env_steps, wall_time=time.time())
        for name, value in values.items():
            if value is not None:
                event.summary.value.extend(scalar(name, value).value)
        try:
            self._writer.write_event(event)
        except OSError as error:
            self._end(error)

    def close(self) -> None:
        """Write what is held back. Does nothing the second time."""
        if self._writer is None:
            return
        try:
            self._writer.close()
        except OSError as error:
            self._end(error)
        self._writer = None

    def _end(self, error: OSError) -> None:
        if self._writer is not None:
            # Its own `close` first writes what is held back, and where that fails leaves the file open.
            with contextlib.suppress(OSError):
                self._writer._py_recordio_writer.close()
        self._writer = None
        self._warn(f"the curves in {self._folder} end here: {error.strerror}; the log has all numbers")
