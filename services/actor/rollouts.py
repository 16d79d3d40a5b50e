"""A collected rollout, and the message that carries it to the learner.

Axis letters as in `common.wire.messages`: T steps, N environments, O observation, A action; m is N in a run that
branches and else 0.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Generic, TypeVar

import jax
import numpy as np
from jax import Array

from common.wire.rollout import Rollout
from services.worker.joining import Assignment

Numbers = TypeVar("Numbers", Array, np.ndarray)
"""Arrays on the device or on the host."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trajectory(Generic[Numbers]):
    """Steps of N environments, with the time axis in front."""

    obs: Numbers
    """[T, N, O], before the step."""
    action: Numbers
    log_prob: Numbers
    reward: Numbers
    terminated: Numbers
    truncated: Numbers
    next_obs: Numbers
    """[T, N, O], after the step and in the same episode; without elements where only `obs` is used."""
    episode_return: Numbers
    """[T, N], of the episode that ended at this step, else 0."""
    episode_length: Numbers


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CollectedRollout(Generic[Numbers]):
    """T steps of the environments of one slot.

    Attributes:
        trajectory: the steps.
        last_obs: [N, O] after the last step.
        truncated_obs: [N, O] at which the time limit truncated an episode, each environment's last.
        mirror: the last step repeated with the mirrored action, of m environments and without a time axis.
        diverged: [] int32, number of episodes that ended because their simulation diverged.
    """

    trajectory: Trajectory[Numbers]
    last_obs: Numbers
    truncated_obs: Numbers
    mirror: Trajectory[Numbers]
    diverged: Numbers


def rollout_message(
    collected: CollectedRollout[np.ndarray],
    assignment: Assignment,
    *,
    seq: int,
    version: int,
    timing: dict[str, float],
) -> Rollout:
    """The message for rollout number `seq`, collected under policy `version`.

    Ended episodes and truncated observations are ordered by time, then environment.
    """
    steps, mirror = collected.trajectory, collected.mirror
    ended = steps.terminated | steps.truncated
    _, truncated_envs = np.nonzero(steps.truncated)
    return Rollout(
        run=assignment.run,
        slot=assignment.slot,
        incarnation=assignment.incarnation,
        generation=assignment.generation,
        seq=seq,
        policy_version=version,
        t_ns=time.time_ns(),
        timing=timing,
        obs=steps.obs,
        action=steps.action,
        log_prob=steps.log_prob,
        reward=steps.reward,
        terminated=steps.terminated,
        truncated=steps.truncated,
        last_obs=collected.last_obs,
        truncated_obs=collected.truncated_obs[truncated_envs],
        episode_return=steps.episode_return[ended],
        episode_length=steps.episode_length[ended],
        mirror_action=mirror.action,
        mirror_reward=mirror.reward,
        mirror_terminated=mirror.terminated,
        mirror_truncated=mirror.truncated,
        mirror_obs=mirror.next_obs,
        diverged=int(collected.diverged),
    )
