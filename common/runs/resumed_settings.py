"""The settings of a resumed run: those it began with, except for the few that may change."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.config.sources import parse_json
from common.errors import LogReadError, SettingsError
from common.files import read_text
from common.log.reader import LogReader
from common.log.segments import LOG_DIRECTORY, list_segments, unreadable
from common.runs.directory import SETTINGS, SUMMARY
from common.runs.needed_segments import read_tally

KEPT_APART = ("transport.", "run_dir", "log.signing_key", "log.keep", "track", "device_memory")
"""Settings, or sections of them, that say where and how a run is kept and computed, not which run it is."""

MAY_CHANGE = (*KEPT_APART, "total_steps")
"""Settings, or sections of them, that do not affect what a run learns from the experience it has collected."""


@dataclass(frozen=True)
class Interrupted:
    """A run directory as it was left.

    `complete`: all updates of `settings` were made, and evaluated. `shutdown_pending`: it is complete, but its log was
    not closed; a learner does that last, after its actors were notified that the run is over. `began_ns`: the time of
    its first record; 0 where it has none.
    """

    run_dir: Path
    settings: RunSettings
    complete: bool
    shutdown_pending: bool
    began_ns: int


def holds_run(run_dir: Path) -> bool:
    """True if a run was begun there. LogReadError where the directory cannot be read."""
    try:
        return (run_dir / SETTINGS).exists() or bool(list_segments(run_dir / LOG_DIRECTORY))
    except OSError as error:
        raise unreadable(run_dir, error) from None


def require_run(run_dir: Path) -> None:
    """Raise SettingsError unless a run was begun there."""
    if not holds_run(run_dir):
        raise SettingsError(
            f"--resume {run_dir}: no run was begun there; give the directory of a run, the one that holds its "
            f"{SETTINGS} and {LOG_DIRECTORY}"
        )


def read_interrupted(run_dir: Path) -> Interrupted:
    """The run in a directory.

    Raises:
        SettingsError: there is none.
        LogReadError: its log is damaged.
    """
    require_run(run_dir)
    settings = parse_json(_settings_text(run_dir)).model_copy(update={"run_dir": run_dir.absolute()})
    complete = _is_complete(run_dir)
    return Interrupted(run_dir, settings, complete, complete and _is_open(run_dir), _began_ns(run_dir))


@dataclass(frozen=True)
class AutoChoice:
    """The run that `--resume auto` continues, None to start one, and unfinished runs of these settings passed over."""

    run_dir: Path | None
    passed_over: list[Path]


def choose_interrupted(folder: Path, settings: RunSettings) -> AutoChoice:
    """Choose among the runs of a folder that began with these settings the one whose log was begun last.

    It is continued unless it is complete; an older one is not, for its successor was begun on purpose. Addresses,
    directories and times of files do not count.

    Raises:
        LogReadError: a run whose log is damaged may be of these settings: starting another one would abandon it.
    """
    mine = []
    for path in sorted(folder.glob("*")):
        found = _read_candidate(path, settings) if holds_run(path) else None
        if found is not None:
            mine.append(found)
    mine.sort(key=lambda found: (found.began_ns, found.run_dir))
    unfinished = [found.run_dir for found in mine if found.shutdown_pending or not found.complete]
    chosen = mine[-1].run_dir if mine and mine[-1].run_dir in unfinished else None
    return AutoChoice(chosen, [path for path in unfinished if path != chosen])


def _read_candidate(path: Path, settings: RunSettings) -> Interrupted | None:
    """The run in a directory if it has these settings."""
    try:
        found = read_interrupted(path)
    except SettingsError:
        return None  # this release does not have its settings, so they are not these
    except LogReadError as error:
        if not _beside_says_other(path, settings):
            raise LogReadError(
                f"--resume auto: {path} may be the run to continue, but it cannot be read: {error}. Repair it, move it "
                "away, or name a run with --run-dir"
            ) from None
        return None
    return found if _same(found.settings, settings) else None


def _beside_says_other(path: Path, settings: RunSettings) -> bool:
    """True if the settings beside a damaged log are readable and others than these."""
    try:
        return not _same(parse_json(read_text(path / SETTINGS)), settings)
    except SettingsError:
        return True
    except (OSError, ValueError):
        return False


def _same(recorded: RunSettings, given: RunSettings) -> bool:
    pairs = _differences(recorded.model_dump(mode="json"), given.model_dump(mode="json"))
    return all(name.startswith(KEPT_APART) for name, _, _ in pairs)


def _began_ns(run_dir: Path) -> int:
    """Time of the first record of a log, which may have been removed since; 0 where it has none."""
    segments = list_segments(run_dir / LOG_DIRECTORY)
    if not segments:
        return 0
    if began_ns := read_tally(segments[0], updates=1).began_ns:
        return began_ns
    first = next(LogReader(run_dir).messages(), None)
    return 0 if first is None else first.t_ns


def resumed_settings(found: Interrupted, load: Callable[[RunSettings], RunSettings]) -> RunSettings:
    """The settings to resume with: `load` puts what is given now over those of the run.

    Raises:
        SettingsError: something else than `MAY_CHANGE` would be another run, or there would be fewer steps.
    """
    base = found.settings
    given = load(base)
    # What stood for a value when the run began stands for that value now.
    settled = (("rkhs.capacity", base.capacity), ("algorithm.precision", "auto"))
    changed = [
        f"{name} (it is {json.dumps(old)}, given {json.dumps(new)})"
        for name, old, new in _differences(base.model_dump(mode="json"), given.model_dump(mode="json"))
        if not name.startswith(MAY_CHANGE) and (name, new) not in settled
    ]
    if changed:
        raise SettingsError(
            f"--resume {found.run_dir}: a run goes on with the settings it began with, but for transport and more "
            f"total_steps; leave out {', '.join(changed)}, or start another run"
        )
    if given.run_dir is None or given.run_dir.absolute() != base.run_dir:
        raise SettingsError(f"--resume {found.run_dir}: the run stays there; leave out run_dir {given.run_dir}")
    if given.total_steps < base.total_steps:
        raise SettingsError(
            f"--resume {found.run_dir}: total_steps {given.total_steps} is less than the run's {base.total_steps}; "
            "leave it out, or give more"
        )
    return _as_begun(base, given.model_copy(update={"run_dir": base.run_dir}))


def _as_begun(base: RunSettings, given: RunSettings) -> RunSettings:
    """The given settings with the precision and the capacity of h that the run began with."""
    algorithm = given.algorithm.model_copy(update={"precision": base.algorithm.precision})
    given = given.model_copy(update={"algorithm": algorithm})
    if given.capacity == base.capacity:
        return given
    rkhs = given.rkhs.model_copy(update={"capacity": base.capacity})
    return given.model_copy(update={"rkhs": rkhs})


def _settings_text(run_dir: Path) -> str:
    """The newest settings in the log as JSON; those beside it where the log had not begun."""
    if list_segments(run_dir / LOG_DIRECTORY):
        text = LogReader(run_dir).metadata().get("settings", {}).get("json")
        if text is not None:
            return text
    try:
        return read_text(run_dir / SETTINGS)
    except (OSError, UnicodeDecodeError) as error:
        raise LogReadError(
            f"neither the log in {run_dir} nor {SETTINGS} says what the run was ({error}); start another one"
        ) from None


def _is_complete(run_dir: Path) -> bool:
    try:
        summary = json.loads(read_text(run_dir / SUMMARY))
    except (OSError, ValueError):
        return False
    return isinstance(summary, dict) and summary.get("complete") is True


def _is_open(run_dir: Path) -> bool:
    if not list_segments(run_dir / LOG_DIRECTORY):
        return False
    try:
        return bool(LogReader(run_dir).torn)
    except LogReadError:
        return False  # reading it reports the damage; a run that is over needs nothing more from it


def _differences(old: Mapping[str, Any], new: Mapping[str, Any], section: str = "") -> Iterator[tuple[str, Any, Any]]:
    for name in {**old, **new}:
        before, after = old.get(name), new.get(name)  # settings that are off may be left out
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            yield from _differences(before, after, f"{section}{name}.")
        elif before != after:
            yield f"{section}{name}", before, after
