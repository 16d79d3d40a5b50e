"""A task of one's own: swing a double pendulum up and hold its tip as high as it reaches.

cd examples && reskpn train --config double_pendulum.yaml
"""

import jax
import jax.numpy as jnp

from reskpn.tasks import Data, Task


class DoublePendulum(Task):
    """Motors at shoulder and elbow; the tip hangs one metre below the shoulder at first."""

    mjcf = "double_pendulum.xml"
    frame_skip = 2
    episode_length = 500
    reads = ("site_xpos",)
    position_noise = 0.1
    velocity_noise = 0.1

    def observation(self, data: Data) -> jax.Array:
        """Sine and cosine of both angles, and both velocities."""
        return jnp.concatenate([jnp.sin(data.qpos), jnp.cos(data.qpos), data.qvel])

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        """The height of the tip in metres, from -1 to 1, less a little for effort."""
        return after.site_xpos[0, 2] - 0.01 * jnp.sum(jnp.square(action))

    def terminated(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        """When it spins so fast that nothing is learned any more."""
        return jnp.any(jnp.abs(after.qvel) > 40.0)
