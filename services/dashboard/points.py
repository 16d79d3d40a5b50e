"""The points that the records of a run add to the page: finite numbers under known names, and printable text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from common.printable import printable, shortened, shortened_within

METRICS = (
    "train/policy_loss",
    "train/value_loss",
    "train/kl",
    "train/entropy",
    "train/explained_variance",
    "policy/std",
    "rkhs/centres",
    "rkhs/share",
    "rkhs/step_kl",
    "variance/gradient",
    "variance/one_transition",
)
"""Metrics of an update that the page draws. Others stay in the log: what is kept must not grow with their names."""

PROGRESS = ("return", "step_reward", "steps_per_s")
STALENESS = ("mean", "max")
PHASES = ("wait", "learner", "publish", "record", "log", "actor/physics", "actor/collect", "actor/push")

LONGEST_EVENT = 400


def number(value: object) -> float | None:
    """A finite number with six digits, which is more than a plot shows; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(f"{value:.6g}")


def whole(value: object) -> int | None:
    """A whole number; None for anything else."""
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def text(value: object, limit: int = 200) -> str:
    """Text in one line and without control characters; empty for anything else."""
    return printable(value, limit) if isinstance(value, str) else ""


def update_points(record: Mapping[str, Any]) -> dict[str, float | None]:
    """The points of an `/update` record by the name that TensorBoard has for them."""
    points = {name: number(_part(record, "metrics").get(name)) for name in METRICS}
    for group, key, names in (
        ("run", "progress", PROGRESS),
        ("staleness", "staleness", STALENESS),
        ("seconds", "seconds", PHASES),
    ):
        part = _part(record, key)
        points |= {f"{group}/{name}": number(part.get(name)) for name in names}
    return {name: value for name, value in points.items() if value is not None}


def evaluation_point(record: Mapping[str, Any]) -> dict[str, Any] | None:
    """An `/eval` record, or a report's evaluation, as the page shows it; None where it lacks a number."""
    numbers = {name: number(record.get(name)) for name in ("return_mean", "return_std")}
    counts = {name: whole(record.get(name)) for name in ("version", "env_steps", "episodes")}
    if None in numbers.values() or None in counts.values():
        return None
    return {**numbers, **counts, "source": text(record.get("source", "run"), 40)}


def event_line(record: Mapping[str, Any], t_ns: int) -> dict[str, Any]:
    """An `/event` record as a line with its Unix time in seconds; whole incarnations are secrets and are shortened."""
    told = shortened_within(text(record.get("text"), LONGEST_EVENT))
    return {"t_s": round(t_ns / 1e9, 1), "level": text(record.get("level"), 10), "text": told}


def used_rollouts(record: Mapping[str, Any], t_ns: int) -> dict[int, dict[str, Any]]:
    """The actors whose rollouts an `/update` record used, by slot, with the Unix time of the update in seconds."""
    found: dict[int, dict[str, Any]] = {}
    rollouts = record.get("rollouts")
    for rollout in rollouts if isinstance(rollouts, list) else ():
        slot = whole(rollout.get("slot")) if isinstance(rollout, dict) else None
        if slot is not None:
            found[slot] = {
                "incarnation": shortened(text(rollout.get("incarnation"), 64))[:8],
                "version": whole(rollout.get("policy_version")),
                "t_s": round(t_ns / 1e9, 1),
            }
    return found


def _part(record: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    part = record.get(name)
    return part if isinstance(part, Mapping) else {}
