"""Rollouts of runs that do not branch, as every test of messages may need them."""

import numpy as np


def no_mirror(observation_size: int, action_size: int) -> dict[str, np.ndarray]:
    """What a rollout of a run that does not branch says of mirrored actions."""
    return {
        "mirror_action": np.zeros((0, action_size), np.float32),
        "mirror_reward": np.zeros(0, np.float32),
        "mirror_terminated": np.zeros(0, bool),
        "mirror_truncated": np.zeros(0, bool),
        "mirror_obs": np.zeros((0, observation_size), np.float32),
    }
