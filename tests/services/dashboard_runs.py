"""Run directories for the tests of the page: real logs with made-up figures, written without JAX."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from common.log.writer import LogWriter

T0_NS = 10**18
SECOND_NS = 10**9
BATCH = 12
SECRET = "0123456789abcdef" * 2


def settings(**changes: Any) -> dict[str, Any]:
    values: dict[str, Any] = {
        "task": "hopper", "learner": "reskpn", "seed": 3, "mode": "sync", "actors": 2, "num_envs": 4, "num_steps": 3,
        "total_steps": 100 * BATCH, "transport": {"endpoint": "tcp/127.0.0.1:9"},
        "rkhs": {"representation": "exact", "kernel": "gaussian", "eta": 0.1},
        "algorithm": {"learning_rate": 3e-4, "gamma": 0.99},
    }  # fmt: skip
    return values | changes


def update(version: int, **changes: Any) -> dict[str, Any]:
    """An `/update` record: the return is ten times the version; the phases of the learner make one second."""
    record: dict[str, Any] = {
        "version": version,
        "env_steps": BATCH * version,
        "rollouts": [
            {"slot": slot, "incarnation": SECRET, "generation": 0, "seq": version - 1, "policy_version": version - 1}
            for slot in (0, 1)
        ],
        "state_digest": f"state-{version}",
        "metrics": {
            "train/policy_loss": -0.01, "train/value_loss": 1.0 / version, "train/kl": 0.01 * version,
            "train/explained_variance": 0.5, "policy/std": 1.0 - 0.01 * version, "rkhs/centres": float(version),
            "rkhs/share": 0.25, "rkhs/step_kl": 0.001, "unknown/name": 1.0,
        },
        "seconds": {
            "wait": 0.5, "learner": 0.25, "publish": 0.125, "record": 0.125, "log": 0.05,
            "actor/physics": 0.3, "actor/collect": 0.15, "actor/push": 0.05,
        },
        "staleness": {"min": 0, "mean": 0.0, "max": 0},
        "progress": {"return": 10.0 * version, "step_reward": 0.75, "steps_per_s": 12.0},
    }  # fmt: skip
    return record | changes


def evaluation(version: int, source: str = "evaluator-5f31aa00", mean: float | None = None) -> dict[str, Any]:
    mean = 11.0 * version if mean is None else mean
    figures = {"return_mean": mean, "return_std": 2.0, "return_min": 1.0, "return_max": 3.0}
    lengths = {"length_mean": 9.0, "length_std": 0.0}
    place = {"version": version, "env_steps": BATCH * version, "episodes": 16, "source": source, "behind": 0}
    return place | figures | lengths


def append(run_dir: Path, *messages: tuple[str, dict[str, Any]], begin_s: float = 0.0) -> None:
    """Add messages to the log as the next learner of the run would, a second apart."""
    with LogWriter(run_dir / "log") as log:
        for number, (topic, record) in enumerate(messages):
            log.write(topic, record, t_ns=T0_NS + round((begin_s + number) * SECOND_NS))


def write_run(
    run_dir: Path, updates: int = 3, *, complete: bool = False, name: str = "", given: dict[str, Any] | None = None
) -> Path:
    """A run with so many updates in its log, an event before them and an evaluation of the last."""
    run_dir.mkdir(parents=True)
    chosen = given or settings()
    (run_dir / "settings.json").write_text(json.dumps(chosen))
    messages = [
        ("/spec", {"run": name or f"hopper-reskpn-s3-{run_dir.name}", "settings": chosen}),
        ("/event", {"level": "info", "name": "actor_joined", "text": f"slot 0: incarnation {SECRET}"}),
        *(("/update", update(version)) for version in range(1, updates + 1)),
    ]
    append(run_dir, *messages, *([("/eval", evaluation(updates))] if updates else []))
    if complete:
        write_summary(run_dir)
    return run_dir


def write_summary(run_dir: Path) -> None:
    summary = {
        "run": "hopper", "task": "hopper", "learner": "reskpn", "seed": 3, "total_steps": 1200, "updates": 100,
        "wall_s": 61.0, "env_steps_per_s": 20.0, "train_return_mean": 11.25, "eval_return_mean": 12.5,
        "eval_return_std": 0.5, "eval_episodes": 64, "state_digest": "d1", "complete": True,
    }  # fmt: skip
    (run_dir / "summary.json").write_text(json.dumps(summary))


def sse(messages: list[str]) -> list[tuple[str, Any]]:
    """Name and content of server-sent events."""
    found = []
    for message in messages:
        name, data = message.removesuffix("\n\n").split("\n")
        found.append((name.removeprefix("event: "), json.loads(data.removeprefix("data: "))))
    return found
