"""What the log and whoever watches are told of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from common.wire.assessment import Assessment

OF_THE_RUN = "run"
"""The source of the run's own evaluation at its end; `source_of` gives no such."""

SHOWN = 8
"""Characters of an incarnation that are told: whoever knows all of it could speak for it."""


def eval_record(
    version: int, env_steps: int, returns: np.ndarray, lengths: np.ndarray, *, source: str, behind: int
) -> dict[str, Any]:
    """The `/eval` message of e deterministic episodes: returns [e], lengths [e]."""
    returns, lengths = returns.astype(np.float64), lengths.astype(np.float64)
    return {
        "version": version,
        "env_steps": env_steps,
        "episodes": len(returns),
        "return_mean": float(returns.mean()),
        "return_std": float(returns.std()),
        "return_min": float(returns.min()),
        "return_max": float(returns.max()),
        "length_mean": float(lengths.mean()),
        "length_std": float(lengths.std()),
        "source": source,
        "behind": behind,
    }


def source_of(evaluator: str) -> str:
    """What an evaluator is called in the log and in reports."""
    return f"evaluator-{evaluator[:SHOWN]}"


def is_of_the_run(record: Mapping[str, Any]) -> bool:
    """Whether an `/eval` message is of the run's own evaluation; those of the first release name no source."""
    return record.get("source", OF_THE_RUN) == OF_THE_RUN


def trajectory_record(assessment: Assessment) -> dict[str, Any]:
    """The `/trajectory` message: positions rounded to a millionth, which is finer than any plot."""
    rows = np.round(assessment.qpos.astype(np.float64), 6).tolist()
    steps = [{"time_s": round(t * assessment.step_s, 6), "qpos": row} for t, row in enumerate(rows)]
    return {"version": assessment.version, "source": source_of(assessment.evaluator), "steps": steps}
