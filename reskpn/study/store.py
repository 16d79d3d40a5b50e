"""A folder of results, found again by the settings that decided them."""

from __future__ import annotations

from pathlib import Path

from common.config.settings import RunSettings
from reskpn.study.results import Result, file_name, identity, read_result, revision, settings_of


class Store:
    """The results in a folder and its subfolders.

    A result is known by its settings as this version has them, so one that was written before a setting existed counts
    with that setting's default.
    """

    def __init__(self, folder: Path) -> None:
        """Read all results. LogReadError or SettingsError for a file that is none of this version."""
        self.folder = folder
        self.outdated = 0
        self._results: dict[str, Result] = {}
        for path in sorted(folder.rglob("*.json")):
            self._take(path)

    def __len__(self) -> int:
        return len(self._results)

    def find(self, settings: RunSettings) -> Result | None:
        """The result of a run with these settings, or None."""
        return self._results.get(identity(settings))

    def path(self, settings: RunSettings) -> Path:
        """Where the result of a run with these settings belongs."""
        return self.folder / file_name(settings)

    def reread(self, settings: RunSettings) -> Result | None:
        """The result of a run that has been made since, by this process or another."""
        path = self.path(settings)
        if identity(settings) not in self._results and path.exists():
            self._take(path)
        return self.find(settings)

    def _take(self, path: Path) -> None:
        result = read_result(path)
        settings = settings_of(result)
        if result.revision != revision(settings):
            self.outdated += 1
            return
        self._results[identity(settings)] = result
