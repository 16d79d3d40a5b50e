"""`--resume`: which run is meant, with which settings, and whether there is anything left to do."""

from __future__ import annotations

import argparse
import threading
from collections.abc import Callable
from pathlib import Path

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.log.lock import LogLock
from common.log.repair import refuse_links
from common.log.segments import LOG_DIRECTORY
from common.output import say
from common.runs.directory import RUNS
from common.runs.resumed_settings import (
    choose_interrupted,
    holds_run,
    read_interrupted,
    require_run,
    resumed_settings,
)

AUTO = "auto"


def add_skip_batch(parser: argparse.ArgumentParser) -> None:
    """Add `--skip-batch`."""
    parser.add_argument(
        "--skip-batch",
        action="store_true",
        help="with --resume: set aside the logged batch of the next update, which could not be used",
    )


def refuse_stray_skip(given: argparse.Namespace) -> None:
    """SettingsError for --skip-batch without a run to resume."""
    if given.skip_batch and given.resume in (None, AUTO):
        raise SettingsError("--skip-batch goes with --resume RUN_DIR: it skips the batch at which that run stopped")


def lock_run(run_dir: Path, inherited: int | None = None) -> LogLock:
    """The lock of a run that is to be resumed; `inherited` is the descriptor by which a parent process holds it.

    Raises:
        SettingsError: there is no run.
        LogWriteError: another process holds the lock.
        LogReadError: the directory holds links, or files of another user.
    """
    require_run(run_dir)
    lock = LogLock(run_dir / LOG_DIRECTORY, inherited=inherited)
    try:
        refuse_links(run_dir)
    except BaseException:
        lock.release()
        raise
    return lock


def settings_to_resume(run_dir: Path, load: Callable[[RunSettings], RunSettings]) -> RunSettings | None:
    """The settings to continue with; None, with a line printed, if the run is complete and no more steps are given.

    `load` puts what is given now over the settings of the run. SettingsError as `resumed_settings`.
    """
    found = read_interrupted(run_dir)
    settings = resumed_settings(found, load)
    if found.complete and settings.updates == found.settings.updates:
        print(
            f"{run_dir}: this run has finished, with {settings.updates} updates; "
            "give more --total-steps to continue it",
            flush=True,
        )
        return None
    return settings


def close_log(run_dir: Path, lock: LogLock) -> int:
    """Close the log of a finished run whose learner was killed before it did. Returns 0."""
    from services.learner.resume.plan import repair_log

    if read_interrupted(run_dir).shutdown_pending:
        for note in repair_log(run_dir, lock):
            say(note)
    return 0


def notify_pending_actors(
    run_dir: Path, load: Callable[[RunSettings], RunSettings], stop: threading.Event, lock: LogLock
) -> int:
    """Tell the actors of a finished run that it is over, if its learner was killed before it did. Returns 0.

    Raises as `send_shutdown_notice`, and SettingsError as `resumed_settings`.
    """
    from services.learner.resume.shutdown_notice import send_shutdown_notice

    found = read_interrupted(run_dir)
    if found.shutdown_pending:
        transport = resumed_settings(found, load).transport
        send_shutdown_notice(run_dir, transport, stop=stop, say=say, lock=lock)
    return 0


def run_to_resume(settings: RunSettings) -> str | None:
    """The directory of the run that `--resume auto` continues; None if it starts a new one.

    That is the run in --run-dir, or else the newest one in the folder of runs, if it has these settings and is
    unfinished, or its learner was killed before its actors were told that it is over.
    """
    if settings.run_dir is not None:
        return str(settings.run_dir) if holds_run(settings.run_dir) else None
    choice = choose_interrupted(RUNS, settings)
    for path in choice.passed_over:
        print(
            f"{path} has these settings and is not finished, but was begun before another run of them; continue it "
            f"with --resume {path}",
            flush=True,
        )
    return None if choice.run_dir is None else str(choice.run_dir)
