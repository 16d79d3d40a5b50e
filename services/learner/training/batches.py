"""The batch of one update, assembled from rollouts as they came off the wire."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from common.maths.state import Batch
from common.wire.rollout import Rollout


def assemble(rollouts: Sequence[Rollout]) -> Batch:
    """The batch of an update: rollouts in the order given, their environments side by side.

    One rollout is used as it lies in its message, where the device can read host memory; several are copied.
    """

    def side_by_side(arrays: list[np.ndarray]) -> Array:
        return jnp.asarray(arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=1))

    def end_to_end(arrays: list[np.ndarray]) -> Array:
        return jnp.asarray(np.concatenate(arrays))

    return Batch(
        obs=side_by_side([rollout.obs for rollout in rollouts]),
        action=side_by_side([rollout.action for rollout in rollouts]),
        log_prob=side_by_side([rollout.log_prob for rollout in rollouts]),
        reward=side_by_side([rollout.reward for rollout in rollouts]),
        terminated=side_by_side([rollout.terminated for rollout in rollouts]),
        truncated=side_by_side([rollout.truncated for rollout in rollouts]),
        last_obs=end_to_end([rollout.last_obs for rollout in rollouts]),
        truncated_obs=end_to_end([_truncated_obs(rollout) for rollout in rollouts]),
        slot=jnp.asarray([rollout.slot for rollout in rollouts], jnp.int32),
        fresh=jnp.asarray([rollout.seq == 0 for rollout in rollouts], jnp.bool_),
        mirror_action=end_to_end([rollout.mirror_action for rollout in rollouts]),
        mirror_reward=end_to_end([rollout.mirror_reward for rollout in rollouts]),
        mirror_terminated=end_to_end([rollout.mirror_terminated for rollout in rollouts]),
        mirror_truncated=end_to_end([rollout.mirror_truncated for rollout in rollouts]),
        mirror_obs=end_to_end([rollout.mirror_obs for rollout in rollouts]),
    )


def _truncated_obs(rollout: Rollout) -> np.ndarray:
    """The observation at which each environment's episode was truncated, [N, O]; zero where none was.

    At most one truncation an environment: a rollout is not longer than an episode.
    """
    truncated = np.zeros_like(rollout.last_obs)
    _, environments = np.nonzero(rollout.truncated)
    truncated[environments] = rollout.truncated_obs
    return truncated
