"""The learning curve of one run: what happened at every update, and its summary in about a hundred points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

POINTS = 100
"""Points that a kept curve has at most."""

KEPT = (
    "train/kl",
    "train/clip_fraction",
    "train/entropy",
    "train/value_loss",
    "train/explained_variance",
    "policy/std",
)
"""Metrics of an update that a kept curve has besides those of `KEPT_GROUPS`."""

KEPT_GROUPS = ("rkhs/", "variance/", "critic/")

DIGITS = 6
"""Significant digits of a kept number: more would only make the files larger."""


@dataclass
class Curve:
    """The updates of one run by column, as they come.

    `returns` are sums, sums of squares and counts of the episodes that ended in an update; `reward` is the mean reward
    of a step.
    """

    batch_size: int
    episodes: list[int] = field(default_factory=list)
    return_sum: list[float] = field(default_factory=list)
    return_squares: list[float] = field(default_factory=list)
    reward: list[float] = field(default_factory=list)
    metrics: list[dict[str, float]] = field(default_factory=list)

    def add(self, returns: np.ndarray, reward: float, metrics: Mapping[str, float | None]) -> None:
        """The next update: returns of the episodes that ended in it, mean reward of a step, and its metrics."""
        returns = returns.astype(np.float64)
        self.episodes.append(len(returns))
        self.return_sum.append(float(returns.sum()))
        self.return_squares.append(float(np.square(returns).sum()))
        self.reward.append(reward)
        kept = {name: value for name, value in metrics.items() if value is not None and _is_kept(name)}
        self.metrics.append(kept)

    @property
    def updates(self) -> int:
        return len(self.episodes)

    def newest_return(self, updates: int = 10) -> float | None:
        """Mean return of the episodes of the newest updates; None where none ended in them."""
        count = sum(self.episodes[-updates:])
        return sum(self.return_sum[-updates:]) / count if count else None

    def returns_by_update(self) -> np.ndarray | None:
        """Mean return [updates]; where no episode ended, on the line between the updates around. None without any."""
        episodes = np.asarray(self.episodes)
        at = np.flatnonzero(episodes)
        if not len(at):
            return None
        means: np.ndarray = np.interp(np.arange(self.updates), at, np.asarray(self.return_sum)[at] / episodes[at])
        return means

    def table(self, points: int = POINTS) -> dict[str, list[float | None]]:
        """Columns of at most `points` rows, each over equally many updates (the last over what is left).

        `env_steps` is at the end of a row; `return` and `return_std` are over the episodes that ended in it, `reward`
        and metrics are means over the updates that have them; None where there is nothing.
        """
        width = max(1, math.ceil(self.updates / points))
        rows = [slice(start, min(start + width, self.updates)) for start in range(0, self.updates, width)]
        columns: dict[str, list[float | None]] = {
            "env_steps": [float(row.stop * self.batch_size) for row in rows],
            "episodes": [float(sum(self.episodes[row])) for row in rows],
        }
        moments = [self._moments(row) for row in rows]
        columns["return"] = [mean for mean, _ in moments]
        columns["return_std"] = [std for _, std in moments]
        columns["reward"] = [_mean(self.reward[row]) for row in rows]
        for name in sorted({name for metrics in self.metrics for name in metrics}):
            columns[name] = [_mean([m[name] for m in self.metrics[row] if name in m]) for row in rows]
        return {name: [_rounded(value) for value in column] for name, column in columns.items()}

    def _moments(self, row: slice) -> tuple[float | None, float | None]:
        """Mean and standard deviation of the returns of the episodes of a row."""
        count = sum(self.episodes[row])
        if not count:
            return None, None
        mean = sum(self.return_sum[row]) / count
        return mean, math.sqrt(max(0.0, sum(self.return_squares[row]) / count - mean * mean))


def tail(count: int) -> int:
    """Updates in the last tenth of so many."""
    return max(1, count // 10)


def _is_kept(name: str) -> bool:
    return name in KEPT or name.startswith(KEPT_GROUPS)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _rounded(value: float | None) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return value if value.is_integer() else float(f"{value:.{DIGITS}g}")
