"""Training returns by wall time: what an entrant reports, the kept curve, and what is read off it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from common.config.kinds import Section
from common.errors import LogReadError

BIN_S = 2.0
"""Seconds of a row of a kept curve."""

WINDOW = 0.1
"""Share of the time until then, over whose episodes a return is the mean."""


@dataclass(frozen=True)
class Report:
    """News of an entrant.

    Attributes:
        at_s: seconds since the entrant's process was launched.
        env_steps: environment steps made until then.
        episodes, return_sum: number and sum of returns of the training episodes that ended since the report before.
    """

    at_s: float
    env_steps: int
    episodes: int
    return_sum: float


class WallCurve(Section):
    """A run by wall time, one row for `BIN_S` seconds.

    Attributes:
        time_s: end of the row, in seconds since the launch.
        env_steps: environment steps made until then.
        episodes: training episodes that ended in the row.
        mean_return: their mean return; None where none ended.
    """

    time_s: list[float]
    env_steps: list[int]
    episodes: list[int]
    mean_return: list[float | None]

    def return_at(self, time_s: float) -> float | None:
        """Mean return of the episodes that ended in the last tenth of the time until `time_s`.

        Where none ended in it, that of the newest row before in which any did; None where none has ended yet.
        """
        rows = [row for row, end in enumerate(self.time_s) if end <= time_s and self.episodes[row]]
        late = [row for row in rows if self.time_s[row] > time_s * (1 - WINDOW)] or rows[-1:]
        count = sum(self.episodes[row] for row in late)
        return sum(self.episodes[row] * (self.mean_return[row] or 0.0) for row in late) / count if count else None

    def steps_at(self, time_s: float) -> int:
        """Environment steps made until `time_s`."""
        return max((steps for end, steps in zip(self.time_s, self.env_steps, strict=True) if end <= time_s), default=0)

    def time_to(self, target: float) -> float | None:
        """The first time, in seconds since the launch, at which `return_at` is at least `target`; None if never."""
        for time_s in self.time_s:
            reached = self.return_at(time_s)
            if reached is not None and reached >= target:
                return time_s
        return None


def curve_of(reports: Iterable[Report], duration_s: float) -> WallCurve:
    """The reports of the first `duration_s` seconds, row by row."""
    rows = round(duration_s / BIN_S)
    steps, episodes, sums = [0] * rows, [0] * rows, [0.0] * rows
    for report in reports:
        row = max(0, math.ceil(report.at_s / BIN_S) - 1)
        if row < rows:
            steps[row] = max(steps[row], report.env_steps)
            episodes[row] += report.episodes
            sums[row] += report.return_sum
    for row in range(1, rows):
        steps[row] = max(steps[row], steps[row - 1])
    means = [_rounded(total / count) if count else None for total, count in zip(sums, episodes, strict=True)]
    times = [round((row + 1) * BIN_S, 3) for row in range(rows)]
    return WallCurve(time_s=times, env_steps=steps, episodes=episodes, mean_return=means)


def parse_reports(lines: Sequence[str], launched_s: float) -> tuple[dict[str, Any], list[Report]]:
    """What an entrant printed: a first line about itself, then its reports (`benchmarks.race.reporting`).

    Lines that are no JSON objects are other people's output and left out, as is a last line that was cut off.

    Args:
        launched_s: time of its launch, in seconds since the epoch.

    Raises:
        LogReadError: it never introduced itself, or a report lacks a number.
    """
    about: dict[str, Any] | None = None
    reports = []
    for line in lines:
        content = _json_object(line)
        if content is None:
            continue
        if about is None:
            about = content.get("about")
            continue
        try:
            reports.append(
                Report(
                    float(content["at"]) - launched_s,
                    int(content["env_steps"]),
                    int(content["episodes"]),
                    float(content["return_sum"]),
                )
            )
        except (KeyError, TypeError, ValueError) as error:
            raise LogReadError(f"an entrant's report cannot be read ({error!r}): {line.strip()[:200]}") from None
    if about is None:
        raise LogReadError(
            "the entrant did not get as far as saying what it is in the time it had; give it more minutes"
        )
    return about, reports


def _json_object(line: str) -> dict[str, Any] | None:
    try:
        content = json.loads(line)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
