"""rliable's side of the comparison: scores as JSON on standard input, its statistics as JSON on standard output.

Runs in rliable's environment, which has nothing of this project.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from rliable import library, metrics


PROFILE_RESAMPLES = 10
"""For intervals of the profile, which are not compared."""


def main() -> None:
    given = json.load(sys.stdin)
    x, y = (np.asarray(given[name]) for name in ("x", "y"))
    thresholds = np.asarray(given["thresholds"])
    mean, mean_ends = estimate({"x": x}, metrics.aggregate_iqm, given["resamples"]["interquartile mean"])
    better, better_ends = estimate(
        {"x": (x, y)}, metrics.probability_of_improvement, given["resamples"]["probability of improvement"]
    )
    profiles, _ = library.create_performance_profile({"x": x}, thresholds, reps=PROFILE_RESAMPLES)
    found = {
        "interquartile mean": [mean, *mean_ends],
        "probability of improvement": [better, *better_ends],
        "performance profile": np.asarray(profiles["x"]).tolist(),
    }
    print(json.dumps(found))


def estimate(scores: dict[str, Any], statistic: Any, resamples: int) -> tuple[float, list[float]]:
    """A statistic and the ends of its stratified percentile bootstrap interval at 95%."""
    values, ends = library.get_interval_estimates(
        scores, lambda *of: np.array([statistic(*of)]), reps=resamples, random_state=np.random.RandomState(1)
    )
    return float(values["x"][0]), [float(end) for end in ends["x"][:, 0]]


if __name__ == "__main__":
    main()
