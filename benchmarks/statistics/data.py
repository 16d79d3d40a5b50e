"""Fixed, made-up scores of two learners, and how closely each statistic must agree."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Scores = dict[str, np.ndarray]
"""By task, one score a run."""

TASKS, RUNS = 8, 10

THRESHOLDS = np.linspace(0.0, 3.0, 31)

EXACT = 1e-12
RESAMPLED = {"interquartile mean": 0.03, "probability of improvement": 0.07}
"""Largest difference of an interval's end, as a share of the interval's width. The ends are quantiles of resamples that
are drawn independently on both sides: these are at least four standard errors of their difference (`RESAMPLES`)."""

RESAMPLES = {"interquartile mean": 20_000, "probability of improvement": 2_000}
"""Resamples of rliable; of ours 20,000."""

OWN_RESAMPLES = 20_000


def scores() -> tuple[Scores, Scores]:
    """Two learners: skewed scores that differ by task, rounded to a tenth so that there are ties."""
    random = np.random.default_rng(20261128)
    made = []
    for advantage in (1.0, 1.25):
        scale = advantage * random.uniform(0.5, 1.5, (TASKS, 1))
        values = np.round(random.gamma(2.0, 0.5, (TASKS, RUNS)) * scale, 1)
        made.append({f"task-{number}": row for number, row in enumerate(values)})
    return made[0], made[1]


def as_matrix(found: Mapping[str, np.ndarray]) -> list[list[float]]:
    """[runs][tasks], as rliable wants them."""
    columns: list[list[float]] = np.stack(list(found.values()), axis=1).tolist()
    return columns
