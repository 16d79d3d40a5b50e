"""The array sizes of the rollouts of a run."""

from __future__ import annotations

from common.config.settings import RunSettings
from common.wire.rollout import RolloutShape


def rollout_shape(settings: RunSettings) -> RolloutShape:
    """The sizes of one actor's rollouts."""
    task = settings.sizes
    return RolloutShape(
        num_steps=settings.num_steps,
        num_envs=settings.envs_per_actor,
        observation_size=task.observation_size,
        action_size=task.action_size,
        branches=settings.branches // settings.actors,
        episode_length=settings.episode_length,
    )
