"""Which updates of a learner are traced, as `--trace` says it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from common.errors import SettingsError

WARM_UP = 2
"""Updates of a process that are not traced unless their versions are named: they touch memory for the first time."""

MOST = 1000
"""Updates of one trace, which is held in memory until it is written."""


@dataclass(frozen=True)
class TracePlan:
    """`count` updates, from the one that leads to version `first` on; where that is None, once the process is warm."""

    count: int
    first: int | None = None

    @classmethod
    def parse(cls, text: str) -> TracePlan:
        """A plan that is written as N, or as N@VERSION. SettingsError for whatever else there is."""
        found = re.fullmatch(r"(\d{1,9})(?:@(\d{1,9}))?", text.strip(), re.ASCII)
        if found is None or not 1 <= int(found[1]) <= MOST or int(found[2] or 1) < 1:
            raise SettingsError(
                f"--trace {text}: write N for the number of updates to trace, 1 to {MOST}, or N@VERSION for those from "
                "the one on that leads to that version, which is 1 for the first, as in --trace 5 or --trace 5@100"
            )
        return cls(int(found[1]), None if found[2] is None else int(found[2]))

    def is_due(self, version: int, made: int) -> bool:
        """True if the update that leads to `version`, after `made` others in this process, may be the first."""
        return made >= WARM_UP if self.first is None else version >= self.first

    def written(self) -> str:
        """As `parse` reads it."""
        return f"{self.count}" if self.first is None else f"{self.count}@{self.first}"
