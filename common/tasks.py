"""The eight tasks of the paper, with the sizes that networks and messages need.

Sizes are those of `brax.envs` (checked against it by a test), so that the learner needs no physics engine.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
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


def unknown_name(kind: str, given: str, allowed: Iterable[str]) -> str:
    """The sentence for a name that is not in a table, with the nearest one that is."""
    names = list(allowed)
    by_lower = {name.lower(): name for name in names}
    near = [by_lower[name] for name in difflib.get_close_matches(given.lower(), by_lower, n=1, cutoff=0.5)]
    hint = f"did you mean {near[0]!r}? " if near else ""
    return f"{given!r} is not a {kind}; {hint}allowed: {', '.join(names)}"
