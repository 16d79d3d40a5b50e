"""The class that a task is made of: a model, an observation, a reward, and when an episode ends.

Subclasses are short: see docs/tasks.md and examples/double_pendulum.py. All functions are written for one simulation
with `jax.numpy`; they run on both engines, mapped over all environments and compiled.
"""

from __future__ import annotations

import abc
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from common.physics.simulation import Data
from common.tasks import EPISODE_LENGTH


class Task(abc.ABC):
    """A task. Attributes of the class say what is simulated, and functions what it is worth.

    `model` is the compiled model, set before any function is called: for ids of bodies and constants of the model.
    """

    mjcf: ClassVar[str | Path]
    """MJCF as text, or the path of its file, relative to the file of the class."""
    frame_skip: ClassVar[int] = 1
    """MuJoCo steps of one environment step."""
    episode_length: ClassVar[int] = EPISODE_LENGTH
    """Steps after which the time limit truncates an episode, unless the run's settings say otherwise."""
    reads: ClassVar[tuple[str, ...]] = ()
    """Fields of MuJoCo's data that the functions read beside `qpos`, `qvel` and `act`, such as "site_xpos"."""
    position_noise: ClassVar[float] = 0.0
    """The first positions differ from the model's by at most this much, uniformly."""
    velocity_noise: ClassVar[float] = 0.0
    """The same of the first velocities."""

    model: mujoco.MjModel

    @property
    def step_s(self) -> float:
        """Simulated seconds of one environment step."""
        return float(self.model.opt.timestep) * self.frame_skip

    def first_state(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Joint positions [nq] and velocities [nv] in which an episode starts."""
        for_positions, for_velocities = jax.random.split(key)
        qpos = jnp.asarray(self.model.qpos0, jnp.float32)
        return (
            qpos + self.position_noise * uniform(for_positions, qpos.shape),
            self.velocity_noise * uniform(for_velocities, (self.model.nv,)),
        )

    def command(self, action: jax.Array) -> jax.Array:
        """The actuators' commands [nu] for an action [nu] in [-1, 1]: the range of each actuator, if it has one."""
        low, high = np.asarray(self.model.actuator_ctrlrange, np.float32).T
        limited = np.asarray(self.model.actuator_ctrllimited, bool)
        return jnp.where(limited, low + (action + 1.0) * (0.5 * (high - low)), action)

    @abc.abstractmethod
    def observation(self, data: Data) -> jax.Array:
        """The observation, a vector [O]."""

    @abc.abstractmethod
    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        """The reward [] of a step under an action [nu] in [-1, 1]."""

    def terminated(self, before: Data, action: jax.Array, after: Data) -> Any:
        """True, a bool [], where the step ended the episode for a reason other than its length. By default never."""
        return jnp.asarray(False)


def uniform(key: jax.Array, shape: tuple[int, ...], scale: float = 1.0) -> jax.Array:
    """Numbers between -scale and scale."""
    return jax.random.uniform(key, shape, minval=-scale, maxval=scale)
