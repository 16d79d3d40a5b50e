"""Small settings and well-formed messages for the tests of the services."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from mirrors import no_mirror

from common.config.settings import RunSettings
from common.physics.state_shapes import state_shapes
from common.runs.recorded_updates import RecordedUpdate
from common.tasks import TASKS
from common.wire.messages import Evaluation, Heartbeat, Join, Snapshot, digest_arrays
from common.wire.report import Progress
from common.wire.rollout import Rollout

RUN = "run-1"


STATUS_NOW = Progress(
    phase="training", text="", version=5, updates=10, env_steps=60, total_steps=120, steps_per_s=30.0,
    train_return=8.5, step_reward=0.25, staleness=0.0, centres=5, capacity=10, actors=2, slots=2,
)  # fmt: skip


def settings(**changes: Any) -> RunSettings:
    """Two actors with two inverted pendulums each (O = 4, A = 1), three steps a rollout, ten updates."""
    sizes = {"actors": 2, "num_envs": 4, "num_steps": 3, "total_steps": 120}
    small = {"algorithm": {"hidden": (8, 8), "minibatches": 2}, "physics": "native"}
    return RunSettings.model_validate(sizes | small | changes)


def rollout(slot: int = 0, incarnation: str = "a", seq: int = 0, policy_version: int = 0, **changes: Any) -> Rollout:
    """A rollout of `settings()`: T = 3, N = 2, O = 4, A = 1. Its numbers are the same for the same names."""
    rng = np.random.default_rng([slot, seq, policy_version, *incarnation.encode()])

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    values: dict[str, Any] = {
        "run": RUN,
        "slot": slot,
        "incarnation": incarnation,
        "seq": seq,
        "policy_version": policy_version,
        "t_ns": 1,
        "obs": draw(3, 2, 4),
        "action": draw(3, 2, 1),
        "log_prob": draw(3, 2),
        "reward": draw(3, 2),
        "terminated": np.zeros((3, 2), bool),
        "truncated": np.zeros((3, 2), bool),
        "last_obs": draw(2, 4),
        "truncated_obs": np.zeros((0, 4), np.float32),
        "episode_return": np.zeros(0, np.float32),
        "episode_length": np.zeros(0, np.int32),
        "timing": {"collect": 0.25, "physics": 0.5},
        **no_mirror(4, 1),
    }
    return Rollout(**values | changes)


def environment_arrays(fill: int = 0, task: str = "inverted_pendulum", num_envs: int = 2) -> dict[str, np.ndarray]:
    """The state of two environments of `settings()`, every number of it `fill`; they are at their first step."""
    shapes = state_shapes(TASKS[task], num_envs)
    return {path: np.full(shape, 0 if path == "steps" else fill, dtype) for path, (dtype, shape) in shapes.items()}


def heartbeat(slot: int = 0, incarnation: str = "a", state: str = "waiting", **changes: Any) -> Heartbeat:
    values: dict[str, Any] = {"run": RUN, "slot": slot, "incarnation": incarnation, "state": state}
    numbers = {"version": 0, "env_steps": 0, "steps_per_s": 0.0, "state_s": 0.0, "t_ns": 1}
    return Heartbeat(**values | numbers | changes)


def evaluation(slot: int = 0, incarnation: str = "a", version: int = 0) -> Evaluation:
    """Two episodes: returns 10 and 30, lengths 5 and 7."""
    returns, lengths = np.array([10, 30], np.float32), np.array([5, 7], np.int32)
    return Evaluation(RUN, slot, incarnation, version, returns, lengths)


def question(incarnation: str = "a", **changes: Any) -> Join:
    values = {"run": "", "role": "actor", "versions": {"python": "3.11"}, "hardware": {"host": "here"}}
    return Join(**{"incarnation": incarnation, "physics": "native"} | values | changes)


def snapshot(version: int = 0) -> Snapshot:
    arrays = {"parameters/w": np.full((2, 3), version, np.float32), "count": np.array(version, np.int32)}
    return Snapshot(RUN, version, digest_arrays(arrays), arrays)


def update_record(version: int, digest: str, rollouts: Iterable[Rollout]) -> dict[str, Any]:
    """The `/update` message of a learner that used these rollouts."""
    names = ("slot", "incarnation", "generation", "seq", "policy_version")
    return {
        "version": version,
        "env_steps": 12 * version,
        "rollouts": [{name: getattr(one, name) for name in names} for one in rollouts],
        "state_digest": digest,
        "metrics": {},
        "seconds": {},
        "staleness": {},
    }


def recorded_update(version: int, digest: str, rollouts: list[Rollout]) -> RecordedUpdate:
    """The same as a log gives it back."""
    return RecordedUpdate(version, 12 * version, rollouts, digest, {}, {}, {}, 0, b"")
