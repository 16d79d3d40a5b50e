"""The state of tasks that read MuJoCo's data by its own names: Gymnasium's, and those of one's own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from common.errors import SettingsError
from common.physics.bodies import WITHOUT_MJX, Scales, WriteFields
from common.suggestions import unknown_name

READABLE = (
    "xpos", "xquat", "xmat", "xipos", "ximat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat", "cam_xpos",
    "cam_xmat", "subtree_com", "xanchor", "xaxis", "ten_length", "ten_velocity", "actuator_length",
    "actuator_velocity", "actuator_force", "cinert", "cdof", "cvel", "cacc", "cfrc_int", "cfrc_ext", "qacc",
    "qfrc_bias", "qfrc_passive", "qfrc_actuator", "qfrc_constraint", "sensordata",
)  # fmt: skip
"""Fields of MuJoCo's data that a task may read beside `qpos` and `qvel`."""

AFTER_CONSTRAINTS = ("cacc", "cfrc_int", "cfrc_ext")
"""Fields that both engines compute only for a sensor that needs them; 0 in the first state, as after `mj_forward`."""

_IN_JAX_IMPLEMENTATION = frozenset({"cinert", "cacc", "cfrc_int", "cfrc_ext", "actuator_velocity", "ten_velocity"})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Simulation:
    """The state from which the next physics step starts, and the fields of MuJoCo's data that the task reads.

    As after `mj_step`, fields that MuJoCo derives from positions and velocities belong to the start of the last
    substep.
    """

    q: jax.Array
    """[nq] positions of the joints."""
    qd: jax.Array
    """[nv] velocities of the joints."""
    warmstart: jax.Array
    """[nv] accelerations with which the constraint solver starts."""
    carried: dict[str, jax.Array]
    """Activations of actuators and the like, where the model has any."""
    read: dict[str, jax.Array]
    scales: Scales


class Data:
    """MuJoCo's data of one simulation as a task reads it: `data.qpos`, `data.qvel`, `data.act`, and what it `reads`."""

    def __init__(self, fields: Mapping[str, jax.Array]) -> None:
        self._fields = fields

    def __getattr__(self, name: str) -> jax.Array:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self._fields[name]
        except KeyError:
            if name in READABLE:
                raise AttributeError(
                    f"data.{name} is read but not asked for: add {name!r} to the task's `reads`"
                ) from None
            raise AttributeError(unknown_name("field of data", name, (*self._fields, *READABLE))) from None


def data_of(state: Simulation) -> Data:
    """The state as a task reads it."""
    return Data({"qpos": state.q, "qvel": state.qd, **state.carried, **state.read})


class ReadingLayout:
    """`Simulation`, with the fields that a task reads."""

    def __init__(self, model: mujoco.MjModel, reads: Sequence[str]) -> None:
        """Raises SettingsError: a field cannot be read, or the model carries what is not kept from step to step."""
        for name in reads:
            if name not in READABLE:
                raise SettingsError(unknown_name("field that a task can read", name, READABLE))
        if model.nhistory or model.npluginstate:
            what = "delays" if model.nhistory else "plugins with a state"
            raise SettingsError(f"the model has {what}, whose state is not kept from step to step; leave them out")
        data = mujoco.MjData(model)
        self.carried = tuple(name for name in ("act", "plastic") if getattr(data, name).size)
        self._first = tuple(np.array(getattr(data, name), np.float32) for name in self.carried)
        self._kept = ("qpos", "qvel", "qacc_warmstart", *self.carried)
        self._reads = tuple(reads)
        self._shapes = {name: np.shape(getattr(data, name)) for name in (*self._kept, *reads)}

    def first(self) -> tuple[np.ndarray, ...]:
        return self._first

    def carried_of(self, state: Simulation) -> tuple[jax.Array, ...]:
        return tuple(state.carried[name] for name in self.carried)

    def shapes(self) -> Sequence[tuple[int, ...]]:
        return tuple(self._shapes.values())

    def rest(self) -> dict[str, tuple[int, ...]]:
        """The shapes of what a `Simulation` holds beside positions, velocities and warm start, by path."""
        kinds = {name: "carried" for name in self.carried} | {name: "read" for name in self._reads}
        return {f"{kind}/{name}": self._shapes[name] for name, kind in kinds.items()}

    def bind(self, batch: Any) -> WriteFields:
        bound = [batch.bind(name) for name in self._shapes]

        def write(results: Sequence[np.ndarray]) -> None:
            for result, field in zip(results, bound, strict=True):
                result[:] = field.reshape(result.shape)

        return write

    def state(self, results: Sequence[jax.Array], scales: Scales) -> Simulation:
        return self._state(dict(zip(self._shapes, results, strict=True)), scales)

    def state_of(self, data: Any, scales: Scales) -> Simulation:
        first = dict(zip(self.carried, self._first, strict=True))
        found = {
            name: jnp.asarray(first[name]) if name in WITHOUT_MJX else _field(data, name).reshape(shape)
            for name, shape in self._shapes.items()
        }
        return self._state(found, scales)

    def _state(self, found: Mapping[str, jax.Array], scales: Scales) -> Simulation:
        return Simulation(
            q=found["qpos"],
            qd=found["qvel"],
            warmstart=found["qacc_warmstart"],
            carried={name: found[name] for name in self.carried},
            read={name: found[name] for name in self._reads},
            scales=scales,
        )


def _field(data: Any, name: str) -> jax.Array:
    """A field of an `mjx.Data`, some of which belong to its implementation."""
    field: jax.Array = getattr(data._impl if name in _IN_JAX_IMPLEMENTATION else data, name)
    return field
