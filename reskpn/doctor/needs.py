"""Disk and memory that a run will need, estimated from its settings."""

from __future__ import annotations

from dataclasses import dataclass

from common.config.settings import RunSettings
from common.runs.directory import KEPT_CHECKPOINTS
from common.runs.rollout_shape import rollout_shape

UPDATE_BYTES = 8_000
"""Records of one update in the log and the curves, without its rollouts."""

ROLLOUT_BYTES = 600
"""A rollout without its arrays: names, numbers and the log's framing."""

PROCESS_BYTES = 800e6
"""Resident memory of a learner or an actor that has compiled, beside what its run's sizes add."""


@dataclass(frozen=True)
class Needs:
    """In bytes."""

    log: float
    memory: float


def rollout_bytes(settings: RunSettings) -> int:
    """One rollout in the log: T x N of observation, action, log-probability, reward and two flags, and the last N.

    Where the run branches, the mirrored step as well.
    """
    shape = rollout_shape(settings)
    step = 4 * (shape.observation_size + shape.action_size + 2) + 2
    last = 4 * shape.observation_size
    mirrored = shape.branches * (step - 4 + last)
    return shape.num_envs * (shape.num_steps * step + last) + mirrored + ROLLOUT_BYTES


def needs(settings: RunSettings, policy_bytes: int, state_bytes: int) -> Needs:
    """The needs of a whole run on one machine: its directory at the end, and all its processes.

    Args:
        policy_bytes, state_bytes: arrays of a snapshot, and of a checkpoint.
    """
    policies = settings.updates // settings.log.policy_every + 1
    log = (
        settings.updates * (settings.actors * rollout_bytes(settings) + UPDATE_BYTES)
        + policies * policy_bytes
        + KEPT_CHECKPOINTS * state_bytes
    )
    # A rollout is held as arrays, as a message, and in the queue, and the batch once more for the update. Rollouts
    # that wait in async mode are held as arrays.
    batch = (4 + settings.staleness) * settings.actors * rollout_bytes(settings)
    memory = (1 + settings.actors) * (PROCESS_BYTES + policy_bytes) + 2 * state_bytes + batch
    return Needs(log=float(log), memory=memory)
