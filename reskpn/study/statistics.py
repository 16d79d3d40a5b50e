"""Statistics of few runs on several tasks (Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the
Statistical Precipice").

Scores are given as `Strata`: for each task, an array of one score a run. Tasks may have different numbers of runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

Strata = Mapping[str, np.ndarray]

RESAMPLES = 2000
LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """A statistic with the ends of its confidence interval."""

    value: float
    low: float
    high: float

    def __format__(self, spec: str) -> str:
        return f"{self.value:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"


def pooled(scores: Strata) -> np.ndarray:
    """The scores of all tasks in one array."""
    return np.concatenate([np.asarray(values, np.float64) for values in scores.values()])


def interquartile_mean(runs: np.ndarray) -> np.ndarray:
    """The mean of the middle half along the last axis: a quarter of the runs (rounded down) is cut at each end."""
    result: np.ndarray = stats.trim_mean(runs, 0.25, axis=-1)
    return result


def mean(runs: np.ndarray) -> np.ndarray:
    """The mean along the last axis."""
    return runs.mean(axis=-1)


def bootstrap(
    scores: Strata, statistic: Callable[[np.ndarray], np.ndarray], *, resamples: int = RESAMPLES, seed: int = 0
) -> Estimate:
    """A statistic of the runs of all tasks with its percentile interval at 95%, by resampling runs within each task.

    Args:
        statistic: reduces the last axis, in which the runs of all tasks are.
    """
    random = np.random.default_rng(seed)
    drawn = [np.asarray(values)[_rows(len(values), resamples, random)] for values in scores.values()]
    return _interval(float(statistic(pooled(scores))), statistic(np.concatenate(drawn, axis=1)))


def probability_of_improvement(scores: Strata, over: Strata) -> float:
    """The mean over the tasks that both have of P(X > Y) + P(X = Y) / 2, for a run X of `scores` and Y of `over`."""
    return float(np.mean([table.mean() for table in _comparisons(scores, over)]))


def improvement(scores: Strata, over: Strata, *, resamples: int = RESAMPLES, seed: int = 0) -> Estimate:
    """`probability_of_improvement` with its interval, by resampling the runs of both within each task."""
    random = np.random.default_rng(seed)
    drawn = []
    for table in _comparisons(scores, over):
        rows, columns = (_rows(count, resamples, random) for count in table.shape)
        drawn.append(table[rows[:, :, None], columns[:, None, :]].mean(axis=(1, 2)))
    return _interval(probability_of_improvement(scores, over), np.mean(drawn, axis=0))


def performance_profile(scores: Strata, thresholds: np.ndarray) -> np.ndarray:
    """The share of runs whose score is above each threshold, the mean over tasks."""
    shares = [(np.asarray(values)[None, :] > thresholds[:, None]).mean(axis=1) for values in scores.values()]
    result: np.ndarray = np.mean(shares, axis=0)
    return result


def mean_interval(runs: np.ndarray, *, resamples: int = 500, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the bootstrap interval of the mean of curves [runs, points], point by point."""
    random = np.random.default_rng(seed)
    rows = random.integers(len(runs), size=(resamples, len(runs)))
    low, high = np.quantile(runs[rows].mean(axis=1), [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    return low, high


def normalised(scores: Strata, start: Mapping[str, float], reference: Mapping[str, float]) -> Strata:
    """Scores in units in which an untrained policy has 0 and the reference 1, by task.

    Args:
        start: the score of the untrained policy.
        reference: that of the reference.
    """
    return {task: (values - start[task]) / (reference[task] - start[task]) for task, values in scores.items()}


def _comparisons(scores: Strata, over: Strata) -> list[np.ndarray]:
    """By shared task, [runs, runs of the other]: 1 where the run is better, 1/2 where both are alike, else 0."""
    pairs = [(np.asarray(scores[task]), np.asarray(over[task])) for task in scores if task in over]
    return [(x[:, None] > y[None, :]) + 0.5 * (x[:, None] == y[None, :]) for x, y in pairs]


def _rows(count: int, resamples: int, random: np.random.Generator) -> np.ndarray:
    """Indices [resamples, count] of runs drawn with replacement."""
    return random.integers(count, size=(resamples, count))


def _interval(value: float, drawn: np.ndarray) -> Estimate:
    low, high = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Estimate(value, float(low), float(high))
