"""Retention: the segments of a run's log that its newest checkpoints do not need are deleted, by `log.keep`."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from common.config.settings import RunSettings
from common.files import open_to_read
from common.log.failures import write_failure
from common.log.segments import LOG_DIRECTORY, list_segments, sync_directory
from common.runs.directory import KEPT_CHECKPOINTS
from common.runs.needed_segments import first_needed
from services.learner.training.checkpoints import ENVIRONMENTS, list_checkpoints


def checkpoints_to_keep(settings: RunSettings) -> int:
    """The number of checkpoint files that a run keeps: the newest one is not complete yet."""
    keep = settings.log.keep
    return KEPT_CHECKPOINTS if keep == "everything" else max(KEPT_CHECKPOINTS, keep + 1)


class Retention:
    """Deletes segments of one run.

    Args:
        on_removed: called with a sentence after segments were deleted.
    """

    def __init__(self, settings: RunSettings, run_dir: Path, on_removed: Callable[[str], None]) -> None:
        self._settings = settings
        self._run_dir = run_dir
        self._on_removed = on_removed

    def apply(self, version: int) -> None:
        """Delete the segments that are not needed; to be called when the log has all updates up to `version`.

        Raises:
            LogWriteError: one cannot be deleted.
            LogReadError: one is damaged at its beginning.
        """
        keep = self._settings.log.keep
        if keep == "everything":
            return
        complete = [found for found in self._complete() if found <= version]
        if len(complete) < keep:
            return
        segments = list_segments(self._run_dir / LOG_DIRECTORY)
        first = first_needed(segments, complete[-keep], self._settings.staleness)
        if not first:
            return
        try:
            # A loss of power must not take the update that the checkpoint is confirmed by.
            with open_to_read(segments[-1]) as file:
                os.fsync(file.fileno())
            for path in segments[:first]:  # the oldest first: killed in between, no gap is left
                path.unlink()
            sync_directory(segments[0].parent)
        except OSError as error:
            raise write_failure(segments[0], error) from error
        self._on_removed(
            f"log.keep {keep}: {segments[0].name} to {segments[first - 1].name} were deleted; the log is kept as far "
            f"as checkpoint {complete[-keep]} and the newer ones need it"
        )

    def _complete(self) -> list[int]:
        """Versions whose checkpoints can be gone on from, in order."""
        paths = list_checkpoints(self._run_dir)
        if self._settings.mode == "sync":
            paths = [path for path in paths if path.with_suffix(ENVIRONMENTS).exists()]
        return [int(path.stem) for path in paths]
