"""The outlets of a running learner: the log, the screen and the curves."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from common.config.settings import RunSettings
from common.errors import LogWriteError
from common.log.chain import START, Chain
from common.log.lock import LogLock
from common.log.segments import LOG_DIRECTORY
from common.log.signatures import Signer
from common.log.writer import LogWriter
from common.numerical_environment import numerical_environment
from common.output import run_output
from common.physics.assets import task_files
from common.runs.directory import TENSORBOARD
from common.runs.initial_state import ATTACHMENT, MEDIA_TYPE
from common.runs.tally import Tally
from common.runtime import hardware, software_versions, source_commit
from common.wire.messages import Snapshot
from services.learner.reporting.curves import EVAL_RETURN, RETURN, comparable_settings
from services.learner.reporting.display import Display, make_display
from services.learner.reporting.scalars import Scalars
from services.learner.reporting.trackers import TrackedRun, make_tracker


class Events:
    """Writes what happened to the run to the log and to the screen."""

    def __init__(self, log: LogWriter, display: Display) -> None:
        self._log = log
        self._display = display

    def add(self, level: str, name: str, text: str) -> None:
        """`level` is info, warning or error; `name` is a slug to filter the log by."""
        self._display.note(f"{level}: {text}" if level != "info" else text)
        self.log(level, name, text)

    def log(self, level: str, name: str, text: str) -> None:
        """As `add`, for what the screen shows by other means."""
        try:
            self._log.write("/event", {"level": level, "name": name, "text": text})
        except LogWriteError:
            return  # the log reports its own failure, which also stops the run


@dataclass(frozen=True)
class Outlets:
    """Open until the run is over. `failures` has the error that ended the log, if there was one."""

    log: LogWriter
    display: Display
    events: Events
    scalars: Scalars
    failures: list[LogWriteError]


@dataclass(frozen=True)
class Beginning:
    """The state that a run begins with, and the run and version that it is of."""

    origin: Mapping[str, str]
    state: Snapshot


@contextmanager
def open_outlets(
    run: str,
    settings: RunSettings,
    run_dir: Path,
    stop: threading.Event,
    *,
    chain: str = START,
    tally: Tally | None = None,
    lock: LogLock | None = None,
    beginning: Beginning | None = None,
) -> Iterator[Outlets]:
    """Open all of them; `stop` is set when the log fails. LogWriteError as `LogWriter`.

    `chain` and `tally`: digest and totals of the log that is there. `lock`: of the log, where the caller
    holds it. `beginning`: of a new run that begins with another's state.
    """
    failures: list[LogWriteError] = []

    def on_log_error(error: LogWriteError) -> None:
        failures.append(error)
        stop.set()

    with ExitStack() as stack:
        log = stack.enter_context(_open_log(run, settings, run_dir, chain, tally, lock, beginning, on_log_error))
        display = make_display(
            f"ResKPN {run}: {settings.learner} on {settings.task}, {settings.updates} updates of "
            f"{settings.batch_size:,} steps\nlistening on {settings.transport.endpoint}; files in {run_dir}",
            run_output(stop.is_set),
        )
        stack.callback(display.close)
        events = Events(log, display)
        compared = comparable_settings(settings)
        tracked = TrackedRun(run, compared, run_dir)
        trackers = [
            make_tracker(name, tracked, lambda text: events.add("warning", "tracker", text)) for name in settings.track
        ]
        scalars = Scalars(run_dir / TENSORBOARD, lambda text: events.add("warning", "curves_ended", text), trackers)
        scalars.add_settings(compared, [RETURN, EVAL_RETURN])
        stack.callback(scalars.close)
        yield Outlets(log, display, events, scalars, failures)


def _open_log(
    run: str,
    settings: RunSettings,
    run_dir: Path,
    chain: str,
    tally: Tally | None,
    lock: LogLock | None,
    beginning: Beginning | None,
    on_error: Callable[[LogWriteError], None],
) -> LogWriter:
    versions = software_versions()
    commit = source_commit()
    attachments = {
        name: ("application/xml" if name.endswith(".xml") else "application/octet-stream", content)
        for name, content in task_files(settings.task).items()
    }
    origin = {} if beginning is None else {"origin": dict(beginning.origin)}
    if beginning is not None:
        attachments[ATTACHMENT] = (MEDIA_TYPE, beginning.state.encode())
    log = LogWriter(
        run_dir / LOG_DIRECTORY,
        segment_bytes=settings.log.segment_bytes,
        compression=settings.log.compression,
        metadata={
            "run": {"run": run, "commit": commit},
            "settings": {"json": settings.model_dump_json()},
            "versions": versions,
            "hardware": hardware(),
            "environment": numerical_environment(),
            **origin,
        },
        attachments=attachments,
        repeat_attachments=settings.log.keep != "everything",
        chain=Chain(chain),
        totals=tally or Tally(settings.updates),
        signer=None if settings.log.signing_key is None else Signer(settings.log.signing_key),
        lock=lock,
        on_error=on_error,
    )
    spec = {"run": run, "commit": commit, "settings": settings.model_dump(mode="json"), "versions": versions}
    log.write("/spec", spec | origin)
    return log
