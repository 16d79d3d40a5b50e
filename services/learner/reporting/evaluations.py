"""The records of an evaluation, for the log and for those who watch the run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from common.wire.assessment import Assessment

OF_THE_RUN = "run"
"""The source of the run's own evaluation at its end; `source_of` never returns it."""

SHOWN = 8
"""Characters of an incarnation that are shown: a process that knew all of it could pose as the evaluator."""


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
    """The name of an evaluator in the log and in reports."""
    return f"evaluator-{evaluator[:SHOWN]}"


def is_of_the_run(record: Mapping[str, Any]) -> bool:
    """True for an `/eval` message of the run's own evaluation; in logs of the first release it names no source."""
    return record.get("source", OF_THE_RUN) == OF_THE_RUN


def trajectory_record(assessment: Assessment) -> dict[str, Any]:
    """The `/trajectory` message: positions rounded to a millionth, which is finer than any plot."""
    rows = np.round(assessment.qpos.astype(np.float64), 6).tolist()
    steps = [{"time_s": round(t * assessment.step_s, 6), "qpos": row} for t, row in enumerate(rows)]
    return {"version": assessment.version, "source": source_of(assessment.evaluator), "steps": steps}
