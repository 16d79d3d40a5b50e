"""The policy of a recorded run as a function of raw observations with clipped actions, and the facts about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from common.config.settings import RunSettings
from common.runs.recorded_run import RecordedRun
from common.runtime import software_versions, source_commit
from common.wire.messages import digest_arrays
from services.learner.training.trainer import Trainer
from services.replay.policies import RecordedPolicy, newest_held_policy, recorded_policy
from services.worker.policy_reader import PolicyReader


@dataclass(frozen=True)
class TrainedPolicy:
    """A policy of a run: `arrays` by path, and the run's settings, which say how they become actions."""

    run: str
    settings: RunSettings
    version: int
    newest: int
    arrays: Mapping[str, np.ndarray]
    exact: bool

    @property
    def digest(self) -> str:
        """Of the arrays, as it stands in the run's snapshots."""
        return digest_arrays(self.arrays)

    def function(self) -> Callable[[jax.Array], jax.Array]:
        """Clipped actions [B, A] without exploration, for raw observations [B, O]."""
        reader = self._reader
        policy = reader.read(self.arrays)
        return lambda observation: clipped(reader.mode(policy, observation))

    def function_of_arrays(self) -> Callable[[dict[str, Any], jax.Array], jax.Array]:
        """The same with the policy's arrays as an argument."""
        reader = self._reader
        return lambda arrays, observation: clipped(reader.mode(reader.read(arrays), observation))

    @cached_property
    def _reader(self) -> PolicyReader:
        return PolicyReader(self.settings)


def clipped(action: jax.Array) -> jax.Array:
    """Actions as the environment executes them."""
    return jnp.clip(action, -1.0, 1.0)


def trained_policy(
    recorded: RecordedRun, version: int | None, on_update: Callable[[int], None] = lambda version: None
) -> TrainedPolicy:
    """The policy of a version; for None the newest that the log holds, or else the newest.

    Args:
        on_update: called with each version that is recomputed, for a policy that the log does not hold.

    Raises:
        SettingsError: the run has no such version.
        LogReadError: the log cannot be read.
    """
    found: RecordedPolicy | None = newest_held_policy(recorded) if version is None else None
    if found is None:
        found = recorded_policy(recorded, version, lambda: Trainer(recorded.settings), on_update)
    return TrainedPolicy(recorded.run, recorded.settings, found.version, recorded.newest, found.arrays, found.exact)


def facts(policy: TrainedPolicy, layout: list[str], action_limits: Mapping[str, Any], step_s: float) -> dict[str, Any]:
    """The metadata of an exported policy, all of it JSON."""
    settings = policy.settings
    return {
        "task": settings.task,
        "run": policy.run,
        "learner": settings.learner,
        "representation": settings.rkhs.representation if settings.capacity else None,
        "kernel": settings.rkhs.kernel if settings.capacity else None,
        "version": policy.version,
        "digest": policy.digest,
        "env_steps": policy.version * settings.batch_size,
        "observation": {"size": len(layout), "layout": layout},
        "action": {"size": len(action_limits["actuators"]), "low": -1.0, "high": 1.0, **action_limits},
        "step_s": step_s,
        "versions": software_versions(),
        "commit": source_commit(),
    }
