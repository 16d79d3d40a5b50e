"""The points that a run's records add to its curves, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from common.config.settings import RunSettings
from common.log.reader import LogReader
from common.log.segments import LOG_DIRECTORY, list_segments
from services.learner.reporting.evaluations import is_of_the_run
from services.learner.reporting.scalars import Scalars

# TensorBoard opens the first groups in alphabetical order; the figures that one looks at first are in this one.
CHARTS = "charts"
RETURN, EVAL_RETURN = f"{CHARTS}/return", f"{CHARTS}/eval_return"
STEPS_PER_S = f"{CHARTS}/steps_per_s"

NOT_COMPARED = {"transport", "log", "run_dir", "track", "device_memory"}

_ALSO_IN_CHARTS = {
    "run/return": RETURN,
    "run/step_reward": f"{CHARTS}/step_reward",
    "run/steps_per_s": STEPS_PER_S,
    "train/kl": f"{CHARTS}/kl",
    "policy/std": f"{CHARTS}/std",
    "eval/return": EVAL_RETURN,
}


def points_of_update(record: Mapping[str, Any]) -> dict[str, float | None]:
    """The points of an `/update` message."""
    points = dict(record["metrics"])
    if "diverged" in record:
        points["run/diverged"] = record["diverged"]
    for group, figures in (("seconds", "seconds"), ("staleness", "staleness"), ("run", "progress")):
        points |= {f"{group}/{name}": value for name, value in record.get(figures, {}).items()}
    return _with_charts(points)


def points_of_evaluation(record: Mapping[str, Any]) -> dict[str, float | None]:
    """The points of an `/eval` message: the run's own evaluation, at its end, has curves of its own."""
    group = "final" if is_of_the_run(record) else "eval"
    names = ("return_mean", "return_std", "length_mean")
    return _with_charts({f"{group}/{name.removesuffix('_mean')}": record[name] for name in names})


def restore_points(scalars: Scalars, run_dir: Path) -> None:
    """Add the points that the log of a resumed run has and its curves lack, as after a kill.

    Raises:
        LogReadError: the log is damaged.
    """
    reached = scalars.reached(STEPS_PER_S)
    for topic, record in _newest_records(run_dir / LOG_DIRECTORY, reached):
        points = points_of_update(record) if topic == "/update" else points_of_evaluation(record)
        scalars.add(record["env_steps"], points)
    scalars.flush()


def comparable_settings(settings: RunSettings) -> dict[str, object]:
    """The settings that runs are compared by: those that say how it learns, not where and how it is kept."""
    return dict(_flat(settings.model_dump(mode="json", exclude=NOT_COMPARED)))


def _newest_records(log: Path, reached: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Topic and content of the `/update` and `/eval` messages of the segments that go beyond that many steps."""
    newest: list[list[tuple[str, dict[str, Any]]]] = []
    # From the newest segment back: a log may be far longer than what its curves lack.
    for segment in reversed(list_segments(log)):
        messages = LogReader(segment).messages(["/update", "/eval"])
        records = [(message.topic, message.json()) for message in messages]
        newest.append(records)
        if any(topic == "/update" and record["env_steps"] <= reached for topic, record in records):
            break
    return (record for records in reversed(newest) for record in records)


def _with_charts(points: dict[str, float | None]) -> dict[str, float | None]:
    return points | {_ALSO_IN_CHARTS[name]: value for name, value in points.items() if name in _ALSO_IN_CHARTS}


def _flat(section: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    for name, value in section.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", str(value) if isinstance(value, list) else value
