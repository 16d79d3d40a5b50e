"""How an entrant reports to the race: JSON lines on standard output. Needs the standard library alone, so that it works
in the environments of the peers."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from importlib import metadata
from typing import Any

INTERVAL_S = 0.5
"""Least time between two reports."""


class Reporter:
    """Collects episodes and prints them about twice a second."""

    def __init__(self, packages: tuple[str, ...], settings: Mapping[str, Any]) -> None:
        """Print what the entrant is: the versions of these packages, and its settings as JSON values."""
        versions = {package: metadata.version(package) for package in packages}
        _print({"about": {"versions": versions, "settings": dict(settings)}})
        self._printed_s = 0.0
        self._episodes, self._return_sum = 0, 0.0

    def add(self, env_steps: int, episodes: int, return_sum: float) -> None:
        """Episodes ended, by the time of so many environment steps."""
        self._episodes += episodes
        self._return_sum += return_sum
        now_s = time.time()
        if now_s - self._printed_s < INTERVAL_S:
            return
        _print({"at": now_s, "env_steps": env_steps, "episodes": self._episodes, "return_sum": self._return_sum})
        self._printed_s, self._episodes, self._return_sum = now_s, 0, 0.0


def _print(content: Mapping[str, Any]) -> None:
    print(json.dumps(content), flush=True)
