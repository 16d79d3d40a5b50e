"""A task without its physics: the functions before and after a MuJoCo step, of fields of MuJoCo's data.

With them and the model, a program simulates the task without this package's engines: exported policies bring them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from common.physics.bodies import Scales, bodies_from
from common.physics.lookup import load_definition
from common.physics.models import c_model, load_task
from common.physics.runners import BraxRunner, Runner, TaskRunner
from common.physics.simulation import ReadingLayout
from common.tasks import TASKS

Fields = Mapping[str, Any]
"""Fields of MuJoCo's data by name, float32."""

KEPT = ("qpos", "qvel", "qacc_warmstart")


class _GivenStates:
    """An engine that computes nothing: it returns the states that it is given, and keeps the commands."""

    name = "given"

    def __init__(self, make_first: Callable[[Any, Any], Any], after: Any = None) -> None:
        self._make_first = make_first
        self._after = after
        self.ctrl: Any = None

    def reset(self, q: jax.Array, qd: jax.Array, scales: Scales) -> Any:
        return self._make_first(q, qd)

    def step(self, state: Any, ctrl: jax.Array) -> Any:
        self.ctrl = ctrl
        return state if self._after is None else self._after

    def seconds(self) -> None:
        return None


class StepFunctions:
    """The functions of a task, for one simulation and for use under a JAX transformation.

    model: with the options that the task sets.
    substeps: MuJoCo steps of one environment step.
    step_s: simulated seconds of one environment step.
    action_size: A.
    kept: fields that are loaded before a step, beside `ctrl`; all others start from the model's defaults.
    read: the fields that the functions read, after a step or, in a first state, after `mj_forward`, with their shapes.
    """

    model: mujoco.MjModel
    _make: Callable[[_GivenStates], Runner]
    _state: Callable[[Fields], Any]

    def __init__(self, name: str) -> None:
        """`name`: of the task. SettingsError for a name that is none, or one that may not be imported."""
        if name in TASKS:
            environment = load_task(name)
            self.model, self.substeps = c_model(environment), int(environment._n_frames)
            self._make = partial(BraxRunner, environment)
            self.kept: tuple[str, ...] = KEPT
            names: tuple[str, ...] = ("qpos", "qvel", "xpos", "xquat", "cvel", "subtree_com")
            self._state = self._bodies
        else:
            task = load_definition(name)
            self.model, self.substeps = task.model, task.frame_skip
            layout = ReadingLayout(task.model, task.reads)
            self._make = partial(TaskRunner, task)
            self.kept = (*KEPT, *layout.carried)
            names = tuple(dict.fromkeys((*self.kept, *task.reads)))
            self._state = lambda fields: layout.state([fields[name] for name in names], {})
        data = mujoco.MjData(self.model)
        self.read: dict[str, tuple[int, ...]] = {name: np.shape(getattr(data, name)) for name in names}
        runner = self._run(_GivenStates(lambda q, qd: None))
        self.step_s, self.action_size = runner.step_s, runner.action_size
        self.mujoco_version: str = mujoco.__version__

    def command(self, before: Fields, action: jax.Array) -> jax.Array:
        """The actuators' commands [nu] for an action [A]."""
        engine = _GivenStates(lambda q, qd: None)
        self._run(engine).step(self._state(before), action)
        ctrl: jax.Array = engine.ctrl
        return ctrl

    def outcome(self, before: Fields, action: jax.Array, after: Fields) -> tuple[jax.Array, jax.Array, jax.Array]:
        """The observation [O], the reward [] and the termination [] of a step."""
        engine = _GivenStates(lambda q, qd: None, self._state(after))
        _, obs, reward, terminated = self._run(engine).step(self._state(before), action)
        return obs, reward, jnp.asarray(terminated)

    def first_observation(self, fields: Fields) -> jax.Array:
        """The observation [O] of a first state."""
        _, obs = self._run(_GivenStates(lambda q, qd: self._state(fields))).reset(jax.random.key(0), {})
        return obs

    def first_states(self, key: jax.Array, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions [count, nq] and velocities [count, nv] of first states, drawn as environments do."""
        zeros: dict[str, Any] = {name: np.zeros(shape, np.float32) for name, shape in self.read.items()}

        def first(key: jax.Array) -> tuple[jax.Array, jax.Array]:
            engine = _GivenStates(lambda q, qd: self._state({**zeros, "qpos": q, "qvel": qd}))
            state, _ = self._run(engine).reset(key, {})
            return state.q, state.qd

        qpos, qvel = jax.jit(jax.vmap(first))(jax.random.split(key, count))
        return np.asarray(qpos, np.float32), np.asarray(qvel, np.float32)

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

    def _run(self, engine: _GivenStates) -> Runner:
        with jax.ensure_compile_time_eval():  # a runner reads the time step, a number, from an array
            return self._make(engine)

    def _bodies(self, fields: Fields) -> Any:
        """The state of brax's tasks."""
        xpos = fields["xpos"][1:]
        lever = xpos - fields["subtree_com"][self.model.body_rootid[1:]]
        solved = jnp.zeros(self.model.nv)
        q, qd, rotations, velocities = fields["qpos"], fields["qvel"], fields["xquat"][1:], fields["cvel"][1:]
        return bodies_from(q, qd, xpos, rotations, velocities, lever, solved, {})
