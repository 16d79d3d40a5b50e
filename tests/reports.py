"""Reports of a learner, for the tests of what shows them."""

from __future__ import annotations

from typing import Any

from common.wire.report import ActorReport, Progress, RunReport, Totals


def actor(slot: int = 0, **changes: Any) -> ActorReport:
    values: dict[str, Any] = {
        "slot": slot, "generation": 0, "incarnation": "5f31aa0012", "host": "host-1", "state": "collecting",
        "state_s": 0.25, "physics": "native", "version": 7, "snapshot_age_s": 0.5, "env_steps": 4000,
        "steps_per_s": 1234.5, "heard_s": 0.25, "accepted": 41, "refused": 3, "busy": 2, "repeated": 1,
    }  # fmt: skip
    return ActorReport(**values | changes)


def progress(**changes: Any) -> Progress:
    values: dict[str, Any] = {
        "phase": "training", "text": "", "version": 7, "updates": 100, "env_steps": 7000, "total_steps": 100_000,
        "steps_per_s": 2500.0, "train_return": 12.25, "step_reward": 0.75, "staleness": 0.0, "age_s": 0.5,
    }  # fmt: skip
    return Progress(**values | changes)


def report(**changes: Any) -> RunReport:
    values: dict[str, Any] = {
        "run": "hopper-ppo-s0-ab12", "task": "hopper", "learner": "ppo", "endpoint": "tcp/127.0.0.1:7447", "t_ns": 5,
        "up_s": 61.0, "progress": progress(), "waiting_for": "", "rollouts_there": 1, "slots": 2,
        "actors": [actor(0), actor(1)], "vacancies": [], "totals": Totals(accepted=82, refused=6, joined=2),
        "refusals": {}, "refused_joins": {}, "last_refusal": None,
    }  # fmt: skip
    return RunReport(**values | changes)
