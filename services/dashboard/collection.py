"""The runs that the page can show: found in folders, or told by a learner; followed while somebody looks at them."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection as Several
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from common.errors import SettingsError
from common.runs.listing import ListedRun, describe_run, list_runs
from common.wire.credentials import Credentials
from common.wire.report import RunReport
from services.dashboard.followed_run import GROWING_S, FollowedRun
from services.dashboard.points import number, text
from services.dashboard.run_view import RunView

POLL_S = 1.0

LOOK_S = 5.0
"""Seconds from one look into the folders to the next, at least."""

LOOK_SHARE = 0.002
"""Share of the time that looking into folders may take: large ones are looked into less often."""

IDLE_S = 30.0
"""A run at which nobody has looked for so long is not followed."""

KEPT = 32
"""Runs whose curves are kept in memory."""

MOST_LISTED = 500

FIRST_PARTS = frozenset({"processes", "log"})
"""Parts of a run directory that are there before the learner has written anything into them."""


class ShownRun(Protocol):
    """A run that can be followed."""

    identity: str
    touched_s: float
    view: RunView

    def poll(self) -> bool: ...
    def fresh_report(self) -> RunReport | None: ...


class RunCollection:
    """All runs, by the names that pages ask for them with.

    Args:
        paths: run directories, and folders of runs, in which new ones may appear.
    """

    def __init__(self, paths: Sequence[Path], credentials: Credentials, stop: threading.Event) -> None:
        self._paths = paths
        self._credentials = credentials
        self._stop = stop
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._listed: dict[str, ListedRun | None] = {}
        self._directories: dict[str, Path] = {}
        self._runs: dict[str, ShownRun] = {}
        self._look_s = 0.0
        self._thread = threading.Thread(target=self._follow, name="runs", daemon=True)
        self.look()

    def start(self) -> None:
        self._thread.start()

    def join(self) -> None:
        """Wait for the threads to end, which they do when `stop` is set.

        A thread that is still inside the transport when Python ends would abort the process.
        """
        self._wake.set()
        self._thread.join()
        for run in self._runs.values():
            if isinstance(run, FollowedRun):
                run.join()

    def add(self, run: ShownRun) -> None:
        """Show a run that is in none of the folders."""
        with self._lock:
            self._runs[run.identity] = run
            self._listed[run.identity] = None

    def entries(self) -> list[dict[str, Any]]:
        """A line about every run, the newest first, for the page's chooser."""
        with self._lock:
            listed = list(self._listed.items())[:MOST_LISTED]
            runs = dict(self._runs)
        return [_entry(identity, found, runs.get(identity)) for identity, found in listed]

    def default(self) -> list[str]:
        """The runs that a page shows that asks for none: the newest that is running, or else the newest."""
        with self._lock:
            running = [identity for identity, found in self._listed.items() if is_running(found)]
            return (running or list(self._listed))[:1]

    def running(self) -> list[str]:
        """The runs that are running, the newest first."""
        with self._lock:
            return [identity for identity, found in self._listed.items() if is_running(found)]

    def looked_at(self, identities: Several[str]) -> list[ShownRun]:
        """Those of these runs that there are; they are followed for a while from now on."""
        found: list[ShownRun] = []
        with self._lock:
            for identity in identities:
                run = self._runs.get(identity)
                if run is None and identity in self._directories:
                    run = FollowedRun(self._directories[identity], identity, self._credentials, self._stop)
                    self._runs[identity] = run
                    self._wake.set()
                if run is not None:
                    run.touched_s = time.monotonic()
                    found.append(run)
        return found

    def look(self) -> None:
        """Find the runs of the folders."""
        began_s = time.monotonic()
        found = [listed for path in self._paths for listed in _runs_in(path)]
        names = _names([listed.path for listed in found])
        with self._lock:
            others = {identity: None for identity, listed in self._listed.items() if listed is None}
            self._directories = {name: listed.path for name, listed in zip(names, found, strict=True)}
            self._listed = {**others, **dict(zip(names, found, strict=True))}
        ended_s = time.monotonic()
        self._look_s = ended_s + max(LOOK_S, (ended_s - began_s) / LOOK_SHARE)

    def _follow(self) -> None:
        while not self._stop.is_set():
            began_s = time.monotonic()
            if self._paths and began_s >= self._look_s:
                self.look()
            with self._lock:
                followed = [run for run in self._runs.values() if began_s - run.touched_s < IDLE_S]
                self._forget_oldest()
            # All runs get their turn, also while a long log is read.
            more = [run.poll() for run in followed]
            if not any(more):
                self._wake.wait(max(0.05, POLL_S - (time.monotonic() - began_s)))
            self._wake.clear()

    def _forget_oldest(self) -> None:
        kept = sorted(
            (run for run in self._runs.values() if isinstance(run, FollowedRun)), key=lambda run: run.touched_s
        )
        for run in kept[: max(0, len(kept) - KEPT)]:
            if time.monotonic() - run.touched_s > IDLE_S and not run.linked:
                del self._runs[run.identity]


def check_paths(paths: Sequence[Path]) -> None:
    """SettingsError for a path that is neither a run nor a folder that runs could be in."""
    for path in paths:
        if not path.is_dir():
            raise SettingsError(f"--run-dir {path}: there is no such directory; give a run, or a folder of runs")
        try:
            names = {entry.name for entry in path.iterdir()}
        except OSError as error:
            raise SettingsError(f"--run-dir {path}: cannot be read ({error.strerror})") from None
        if names and not _runs_in(path):
            raise SettingsError(
                f"--run-dir {path}: holds no run: neither settings.json and log/ of one nor directories of runs"
            )


def _runs_in(path: Path) -> list[ListedRun]:
    """The run in a directory, or else those in it as a folder; an empty one may become either, and counts as a run."""
    try:
        names = {entry.name for entry in path.iterdir()}
        own = describe_run(path)
        if own is None and names <= FIRST_PARTS:
            own = ListedRun(path, "-", "-", None, None, None, None, "starting", 0, path.stat().st_mtime)
        return list_runs(path) if own is None else [own]
    except OSError:
        return []


def is_running(listed: ListedRun | None) -> bool:
    """True if a run is being written: its lock says so, or, where locks of other containers cannot be seen, its log."""
    if listed is None or listed.state == "running":
        return True
    return listed.state == "stopped" and time.time() - listed.modified_s < GROWING_S


def _names(paths: Sequence[Path]) -> list[str]:
    """A name for each path: that of its directory, with its parents where two are alike."""
    short = [path.absolute().name for path in paths]
    return [name if short.count(name) == 1 else str(path.absolute()) for name, path in zip(short, paths, strict=True)]


def _entry(identity: str, listed: ListedRun | None, run: ShownRun | None) -> dict[str, Any]:
    state = run.view.state if run is not None else {}
    if listed is None:
        about = {name: state.get(name) for name in ("task", "learner", "env_steps", "total_steps")}
        return {"id": identity, **about, "seed": None, "state": state.get("phase", "running"), "return": None}
    return {
        "id": identity,
        "task": text(listed.task, 80),
        "learner": text(listed.learner, 40),
        "seed": listed.seed,
        "state": "running" if is_running(listed) else listed.state,
        "env_steps": listed.env_steps,
        "total_steps": listed.total_steps,
        "return": number(listed.episode_return),
    }
