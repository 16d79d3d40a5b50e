"""`--from RUN[@VERSION]`: a new run that begins with the state of another, with other settings."""

from __future__ import annotations

import argparse
from pathlib import Path

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.runs.recorded_run import RecordedRun


def add_from(parser: argparse.ArgumentParser) -> None:
    """Add `--from`."""
    parser.add_argument(
        "--from",
        dest="origin",
        metavar="RUN_DIR[@VERSION]",
        help="start a new run with the learner state of that run (default: of its newest checkpoint); its settings "
        "take the place of the defaults",
    )


def refuse_two_beginnings(given: argparse.Namespace) -> None:
    """SettingsError for --from together with --resume."""
    if given.origin is not None and given.resume is not None:
        raise SettingsError("--from starts a new run and --resume continues one: give one of them")


def parse_origin(text: str) -> tuple[Path, int | None]:
    """The directory and the version of `RUN_DIR[@VERSION]`; None where no version is given."""
    path, at, version = text.rpartition("@")
    if at and version.isdecimal():
        return Path(path), int(version)
    return Path(text), None


def origin_settings(text: str) -> RunSettings:
    """The settings of the run that `--from` names, for a run of its own.

    Raises:
        LogReadError: there is no such run.
    """
    settings = RecordedRun(parse_origin(text)[0]).settings.model_copy(update={"run_dir": None})
    if not settings.capacity:
        return settings
    # The default follows from total_steps, and the state would not fit another size.
    return settings.model_copy(update={"rkhs": settings.rkhs.model_copy(update={"capacity": settings.capacity})})
