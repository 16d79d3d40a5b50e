"""Rollouts off the wire, put side by side for one update."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from common.maths.state import Batch, Mirror
from common.wire.messages import Rollout


def assemble(rollouts: Sequence[Rollout]) -> Batch:
    """The batch of an update: rollouts in the order given, their environments side by side.

    One rollout is used as it lies in its message, where the device can read host memory; several are copied.
    """

    def beside(name: str) -> Array:
        arrays = [getattr(rollout, name) for rollout in rollouts]
        return jnp.asarray(arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=1))

    def end_to_end(name: str) -> Array:
        return jnp.asarray(np.concatenate([getattr(rollout, name) for rollout in rollouts]))

    return Batch(
        observation=beside("obs"),
        action=beside("action"),
        log_prob=beside("log_prob"),
        reward=beside("reward"),
        terminated=beside("terminated"),
        truncated=beside("truncated"),
        last_observation=end_to_end("last_obs"),
        truncated_obs=jnp.asarray(np.concatenate([_truncated_obs(rollout) for rollout in rollouts])),
        slot=jnp.asarray([rollout.slot for rollout in rollouts], jnp.int32),
        fresh=jnp.asarray([rollout.seq == 0 for rollout in rollouts], jnp.bool_),
        mirror=Mirror(
            action=end_to_end("mirror_action"),
            reward=end_to_end("mirror_reward"),
            terminated=end_to_end("mirror_terminated"),
            truncated=end_to_end("mirror_truncated"),
            next_observation=end_to_end("mirror_obs"),
        ),
    )


def _truncated_obs(rollout: Rollout) -> np.ndarray:
    """For each environment the observation its episode was cut at, [N, O]; zero where none was.

    At most one cut an environment: a rollout is not longer than an episode.
    """
    cut = np.zeros_like(rollout.last_obs)
    _, environments = np.nonzero(rollout.truncated)
    cut[environments] = rollout.truncated_obs
    return cut
