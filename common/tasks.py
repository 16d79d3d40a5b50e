"""The eight tasks of the paper, with the sizes that networks and messages need.

Sizes are those of `brax.envs` (checked against it by a test), so that the learner needs no physics engine.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Task:
    """One environment: `name` as in `brax.envs`, O = `observation_size`, A = `action_size`."""

    name: str
    observation_size: int
    action_size: int


TASKS: dict[str, Task] = {
    task.name: task
    for task in (
        Task("inverted_pendulum", 4, 1),
        Task("hopper", 11, 3),
        Task("halfcheetah", 17, 6),
        Task("walker2d", 17, 6),
        Task("humanoid", 244, 17),
        Task("humanoidstandup", 244, 17),
        Task("pusher", 23, 7),
        Task("reacher", 11, 2),
    )
}

EPISODE_LENGTH = 1000
"""Steps after which an episode is truncated (paper, section B.3)."""
