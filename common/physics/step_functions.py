"""A task without its physics: the functions before and after a MuJoCo step, of fields of MuJoCo's data.

With them and the model, a program simulates the task without this package's engines: exported policies bring them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from common.physics.bodies import Bodies, bodies_from
from common.physics.libraries import envs
from common.physics.models import c_model, load_task

Fields = Mapping[str, Any]
"""Fields of MuJoCo's data by name, float32."""


class StepFunctions:
    """The functions of a task, for one simulation and for use under a JAX transformation.

    model: with the options that the task sets.
    substeps: MuJoCo steps of one environment step.
    step_s: simulated seconds of one environment step.
    action_size: A.
    kept: fields that are loaded before a step, beside `ctrl`; all others start from the model's defaults.
    read: the fields that the functions read, after a step or, in a first state, after `mj_forward`.
    """

    kept = ("qpos", "qvel", "qacc_warmstart")

    def __init__(self, name: str) -> None:
        """`name`: of the task. SettingsError for a name that is none."""
        self._task = load_task(name)
        self.model: mujoco.MjModel = c_model(self._task)
        self.substeps = int(self._task._n_frames)
        self.step_s = float(self._task.dt)
        self.action_size = int(self._task.action_size)
        self.mujoco_version: str = mujoco.__version__
        data = mujoco.MjData(self.model)
        names = ("qpos", "qvel", "xpos", "xquat", "cvel", "subtree_com")
        self.read = {name: np.shape(getattr(data, name)) for name in names}

    def command(self, before: Fields, action: jax.Array) -> jax.Array:
        """The actuators' commands [nu] for an action [A]."""
        found: list[jax.Array] = []

        def engine_step(bodies: Bodies, ctrl: jax.Array) -> Bodies:
            found.append(ctrl)
            return bodies

        self._task.pipeline_step = engine_step
        self._step(before, action)
        return found[0]

    def outcome(self, before: Fields, action: jax.Array, after: Fields) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The observation [O], the reward [] and the termination [] of a step."""
        self._task.pipeline_step = lambda bodies, ctrl: self._bodies(after)
        state = self._step(before, action)
        return state.obs, jnp.asarray(state.reward, jnp.float32), jnp.asarray(state.done > 0)

    def first_observation(self, fields: Fields) -> jax.Array:
        """The observation [O] of a first state."""
        self._task.pipeline_init = lambda q, qd, act=None, ctrl=None: self._bodies(fields)
        obs: jax.Array = self._task.reset(jax.random.key(0)).obs
        return obs

    def first_states(self, key: jax.Array, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions [count, nq] and velocities [count, nv] of first states, drawn as environments do."""
        zeros: dict[str, Any] = {name: np.zeros(shape, np.float32) for name, shape in self.read.items()}
        self._task.pipeline_init = lambda q, qd, act=None, ctrl=None: self._bodies({**zeros, "qpos": q, "qvel": qd})
        first = jax.jit(jax.vmap(self._task.reset))(jax.random.split(key, count)).pipeline_state
        return np.asarray(first.q, np.float32), np.asarray(first.qd, np.float32)

    def observation_layout(self) -> list[str]:
        """For each number of an observation the number of MuJoCo's data that it is; "computed" where it is none.

        Found by experiment, so that it holds for every task: fields of random numbers, and the observation of them.
        """
        rng = np.random.default_rng(0)
        draws = [
            {name: rng.uniform(-1.0, 1.0, shape).astype(np.float32) for name, shape in self.read.items()}
            for _ in range(2)
        ]
        observe = jax.jit(self.first_observation)
        seen = np.stack([np.asarray(observe(draw)) for draw in draws])
        named = [
            (f"{name} {self._place(name, place)}", np.array([draw[name][place] for draw in draws]))
            for name in self.read
            for place in np.ndindex(self.read[name])
        ]
        return [
            next((name for name, values in named if np.array_equal(values, column)), "computed") for column in seen.T
        ]

    def action_limits(self) -> dict[str, Any]:
        """The actuators in the order of an action, by name or that of the joint moved, and the range of each one's
        command; an action in [-1, 1] becomes a command as the task does it."""
        model = self.model
        names = [
            model.actuator(number).name or model.joint(model.actuator_trnid[number, 0]).name or str(number)
            for number in range(model.nu)
        ]
        ranges = np.where(model.actuator_ctrllimited[:, None].astype(bool), model.actuator_ctrlrange, np.nan)
        return {"actuators": names, "command_ranges": [None if np.isnan(row).any() else row.tolist() for row in ranges]}

    def _place(self, field: str, place: tuple[int, ...]) -> str:
        """A number of a field in words: its joint or body, and its place in that."""
        model = self.model
        starts = {"qpos": model.jnt_qposadr, "qvel": model.jnt_dofadr}.get(field)
        if starts is None:
            return " ".join([model.body(place[0]).name, *map(str, place[1:])])
        joint = int(np.searchsorted(starts, place[0], side="right")) - 1
        width = np.diff([*starts, self.read[field][0]])[joint]
        name = model.joint(joint).name or str(joint)
        return name if width == 1 else f"{name} {place[0] - starts[joint]}"

    def _step(self, before: Fields, action: jax.Array) -> Any:
        zero = np.zeros((), np.float32)
        state = envs.State(pipeline_state=self._bodies(before), obs=zero, reward=zero, done=zero, metrics={}, info={})
        return self._task.step(state, action)

    def _bodies(self, fields: Fields) -> Bodies:
        xpos = fields["xpos"][1:]
        lever = xpos - fields["subtree_com"][self.model.body_rootid[1:]]
        warmstart = jnp.zeros(self.model.nv)
        return bodies_from(
            fields["qpos"], fields["qvel"], xpos, fields["xquat"][1:], fields["cvel"][1:], lever, warmstart
        )
