"""Gymnasium's MuJoCo tasks in their fifth version, so that returns compare with the literature.

Written anew from Gymnasium's definitions and compared with its environments step by step in the tests. Models come
from the installed package; its environments, which need rendering libraries, are not imported. Actions are in [-1, 1]
here and scaled to the actuators' range, as by Gymnasium's `RescaleAction`; costs are those of the scaled action.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from common.errors import PhysicsError
from common.physics.simulation import Data
from common.physics.task import Task, uniform
from common.tasks import GYMNASIUM

LARGEST_VELOCITY = 10.0
"""Limit of the velocities that hopper, walker2d and the double pendulum observe."""


def gymnasium_file(name: str) -> Path:
    """The path of a model in the installed package, which is found without being imported."""
    spec = importlib.util.find_spec("gymnasium")
    if spec is None or not spec.submodule_search_locations:
        raise PhysicsError("gymnasium is not installed: the models of its tasks are needed; run `make setup`")
    return Path(spec.submodule_search_locations[0]) / "envs" / "mujoco" / "assets" / name


class GymnasiumTask(Task):
    """Common parts: the file of the model, the noise, and costs of the command."""

    file: ClassVar[str]
    normal_velocities: ClassVar[bool] = False
    """The first velocities are drawn from a normal distribution, whose standard deviation is `velocity_noise`."""

    def first_state(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        qpos, qvel = super().first_state(key)
        if self.normal_velocities:
            qvel = self.velocity_noise * jax.random.normal(jax.random.fold_in(key, 1), qvel.shape)
        return qpos, qvel

    def effort(self, action: jax.Array) -> jax.Array:
        """The sum of the squared commands []."""
        return jnp.sum(jnp.square(self.command(action)))

    def forward(self, before: Data, after: Data) -> jax.Array:
        """The velocity [] of the first coordinate over the step."""
        return (after.qpos[0] - before.qpos[0]) / self.step_s

    def position(self, data: Data, body: str) -> jax.Array:
        """The position [3] of a body's frame."""
        return data.xpos[self.model.body(body).id]


class Hopper(GymnasiumTask):
    file = "hopper.xml"
    frame_skip = 4
    position_noise = velocity_noise = 5e-3

    def observation(self, data: Data) -> jax.Array:
        velocities = jnp.clip(data.qvel, -LARGEST_VELOCITY, LARGEST_VELOCITY)
        return jnp.concatenate([data.qpos[1:], velocities])

    def healthy(self, data: Data) -> jax.Array:
        state = jnp.concatenate([data.qpos, data.qvel])[2:]
        return jnp.all(jnp.abs(state) < 100.0) & (data.qpos[1] > 0.7) & (jnp.abs(data.qpos[2]) < 0.2)

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        return self.healthy(after) + self.forward(before, after) - 1e-3 * self.effort(action)

    def terminated(self, before: Data, action: jax.Array, after: Data) -> Any:
        return ~self.healthy(after)


class Walker2d(Hopper):
    file = "walker2d_v5.xml"

    def healthy(self, data: Data) -> jax.Array:
        height, angle = data.qpos[1], data.qpos[2]
        return (height > 0.8) & (height < 2.0) & (jnp.abs(angle) < 1.0)


class HalfCheetah(GymnasiumTask):
    file = "half_cheetah.xml"
    frame_skip = 5
    position_noise = velocity_noise = 0.1
    normal_velocities = True

    def observation(self, data: Data) -> jax.Array:
        return jnp.concatenate([data.qpos[1:], data.qvel])

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        return self.forward(before, after) - 0.1 * self.effort(action)


class Swimmer(GymnasiumTask):
    file = "swimmer.xml"
    frame_skip = 4
    position_noise = velocity_noise = 0.1

    def observation(self, data: Data) -> jax.Array:
        return jnp.concatenate([data.qpos[2:], data.qvel])

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        return self.forward(before, after) - 1e-4 * self.effort(action)


class Ant(GymnasiumTask):
    file = "ant.xml"
    frame_skip = 5
    reads = ("xpos", "cfrc_ext")
    position_noise = velocity_noise = 0.1
    normal_velocities = True

    def observation(self, data: Data) -> jax.Array:
        contacts = jnp.clip(data.cfrc_ext[1:], -1.0, 1.0)
        return jnp.concatenate([data.qpos[2:], data.qvel, contacts.ravel()])

    def healthy(self, data: Data) -> jax.Array:
        finite = jnp.all(jnp.isfinite(data.qpos)) & jnp.all(jnp.isfinite(data.qvel))
        return finite & (data.qpos[2] >= 0.2) & (data.qpos[2] <= 1.0)

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        velocity = (after.xpos[1, 0] - before.xpos[1, 0]) / self.step_s
        contact = 5e-4 * jnp.sum(jnp.square(jnp.clip(after.cfrc_ext, -1.0, 1.0)))
        return velocity + self.healthy(after) - 0.5 * self.effort(action) - contact

    def terminated(self, before: Data, action: jax.Array, after: Data) -> Any:
        return ~self.healthy(after)


class Humanoid(GymnasiumTask):
    file = "humanoid.xml"
    frame_skip = 5
    reads = ("cinert", "cvel", "qfrc_actuator", "cfrc_ext", "xipos")
    position_noise = velocity_noise = 1e-2

    def observation(self, data: Data) -> jax.Array:
        parts = [data.qpos[2:], data.qvel, data.cinert[1:], data.cvel[1:], data.qfrc_actuator[6:], data.cfrc_ext[1:]]
        return jnp.concatenate([part.ravel() for part in parts])

    def centre(self, data: Data) -> jax.Array:
        """The first coordinate [] of the centre of mass."""
        mass = np.asarray(self.model.body_mass, np.float32)
        return jnp.dot(mass, data.xipos[:, 0]) / mass.sum()

    def impact(self, data: Data) -> jax.Array:
        """The sum of the squared contact forces [], weighted and limited."""
        return jnp.minimum(5e-7 * jnp.sum(jnp.square(data.cfrc_ext)), 10.0)

    def healthy(self, data: Data) -> jax.Array:
        return (data.qpos[2] > 1.0) & (data.qpos[2] < 2.0)

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        velocity = (self.centre(after) - self.centre(before)) / self.step_s
        return 1.25 * velocity + 5.0 * self.healthy(after) - 0.1 * self.effort(action) - self.impact(after)

    def terminated(self, before: Data, action: jax.Array, after: Data) -> Any:
        return ~self.healthy(after)


class HumanoidStandup(Humanoid):
    file = "humanoidstandup.xml"

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        upwards = after.qpos[2] / float(self.model.opt.timestep)
        return upwards - 0.1 * self.effort(action) - self.impact(after) + 1.0

    def terminated(self, before: Data, action: jax.Array, after: Data) -> Any:
        return jnp.asarray(False)


class InvertedPendulum(GymnasiumTask):
    file = "inverted_pendulum.xml"
    frame_skip = 2
    position_noise = velocity_noise = 0.01

    def observation(self, data: Data) -> jax.Array:
        return jnp.concatenate([data.qpos, data.qvel])

    def terminated(self, before: Data, action: jax.Array, after: Data) -> Any:
        observation = self.observation(after)
        return ~jnp.all(jnp.isfinite(observation)) | (jnp.abs(observation[1]) > 0.2)

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        return 1.0 - self.terminated(before, action, after)


class InvertedDoublePendulum(GymnasiumTask):
    file = "inverted_double_pendulum.xml"
    frame_skip = 5
    reads = ("site_xpos", "qfrc_constraint")
    position_noise = velocity_noise = 0.1
    normal_velocities = True

    def observation(self, data: Data) -> jax.Array:
        angles = data.qpos[1:]
        limited = [jnp.clip(x, -LARGEST_VELOCITY, LARGEST_VELOCITY) for x in (data.qvel, data.qfrc_constraint[:1])]
        return jnp.concatenate([data.qpos[:1], jnp.sin(angles), jnp.cos(angles), *limited])

    def terminated(self, before: Data, action: jax.Array, after: Data) -> Any:
        return after.site_xpos[0, 2] <= 1.0

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        x, _, height = after.site_xpos[0]
        distance = 0.01 * x**2 + (height - 2.0) ** 2
        spin = 1e-3 * after.qvel[1] ** 2 + 5e-3 * after.qvel[2] ** 2
        return 10.0 * ~self.terminated(before, action, after) - distance - spin


class Reacher(GymnasiumTask):
    file = "reacher.xml"
    frame_skip = 2
    reads = ("xpos",)

    def first_state(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        for_angle, for_radius, for_positions, for_velocities = jax.random.split(key, 4)
        # Uniform on the disc of radius 0.2, which Gymnasium draws by rejection from a square.
        angle = uniform(for_angle, (), np.pi)
        radius = 0.2 * jnp.sqrt(jax.random.uniform(for_radius))
        goal = radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        arm = jnp.asarray(self.model.qpos0[:2], jnp.float32) + uniform(for_positions, (2,), 0.1)
        return jnp.concatenate([arm, goal]), jnp.concatenate([uniform(for_velocities, (2,), 5e-3), jnp.zeros(2)])

    def offset(self, data: Data) -> jax.Array:
        return self.position(data, "fingertip") - self.position(data, "target")

    def observation(self, data: Data) -> jax.Array:
        angles, rest = data.qpos[:2], data.qpos[2:]
        return jnp.concatenate([jnp.cos(angles), jnp.sin(angles), rest, data.qvel[:2], self.offset(data)[:2]])

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        return -jnp.linalg.norm(self.offset(after)) - self.effort(action)


class Pusher(GymnasiumTask):
    file = "pusher_v5.xml"
    frame_skip = 5
    reads = ("xpos",)

    def first_state(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        for_cylinder, for_velocities = jax.random.split(key)
        qpos = jnp.asarray(self.model.qpos0, jnp.float32)
        qpos = qpos.at[-4:-2].set(self._cylinder(for_cylinder)).at[-2:].set(0.0)
        return qpos, uniform(for_velocities, (self.model.nv,), 5e-3).at[-4:].set(0.0)

    def _cylinder(self, key: jax.Array) -> jax.Array:
        """A place [2] more than 0.17 from the goal. Drawn until it is, as Gymnasium does."""

        def place(key: jax.Array) -> jax.Array:
            return jax.random.uniform(key, (2,), minval=jnp.array([-0.3, -0.2]), maxval=jnp.array([0.0, 0.2]))

        def near(drawn: tuple[jax.Array, jax.Array]) -> jax.Array:
            return jnp.linalg.norm(drawn[1]) <= 0.17

        def again(drawn: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            key = jax.random.fold_in(drawn[0], 1)
            return key, place(key)

        return jax.lax.while_loop(near, again, (key, place(key)))[1]

    def observation(self, data: Data) -> jax.Array:
        places = [self.position(data, body) for body in ("tips_arm", "object", "goal")]
        return jnp.concatenate([data.qpos[:7], data.qvel[:7], *places])

    def reward(self, before: Data, action: jax.Array, after: Data) -> jax.Array:
        thing = self.position(after, "object")
        to_tip = jnp.linalg.norm(thing - self.position(after, "tips_arm"))
        to_goal = jnp.linalg.norm(thing - self.position(after, "goal"))
        return -0.5 * to_tip - to_goal - 0.1 * self.effort(action)


_CLASSES: tuple[type[GymnasiumTask], ...] = (
    Ant, HalfCheetah, Hopper, Humanoid, HumanoidStandup, InvertedDoublePendulum, InvertedPendulum, Pusher, Reacher,
    Swimmer, Walker2d,
)  # fmt: skip

GYMNASIUM_CLASSES = {f"{cls.__name__.lower()}-v5": cls for cls in _CLASSES}
"""The class of each name in `common.tasks.GYMNASIUM`."""


def gymnasium_class(name: str) -> type[GymnasiumTask]:
    """The class of a task with the model and the episodes of Gymnasium's registry."""
    found = GYMNASIUM_CLASSES[name]
    found.mjcf = gymnasium_file(found.file)
    found.episode_length = GYMNASIUM[name].episode_length
    return found
