"""The states that engines carry from step to step, and the interfaces between tasks, engines and states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import jax
import numpy as np

from common.physics.libraries import Motion, Transform

Scales = dict[str, jax.Array]
"""Factors [] of a simulation's randomised fields by name; empty where nothing is randomised."""

WITHOUT_MJX = ("plastic",)
"""Carried fields that MJX does not have: there they keep their first value."""

WriteFields = Callable[[Sequence[np.ndarray]], None]


class State(Protocol):
    """The part of a simulation's state that all tasks have."""

    @property
    def q(self) -> jax.Array:
        """[nq] positions of the joints."""
        ...

    @property
    def qd(self) -> jax.Array:
        """[nv] velocities of the joints."""
        ...

    @property
    def warmstart(self) -> jax.Array:
        """[nv] accelerations with which the constraint solver starts."""
        ...

    @property
    def scales(self) -> Scales: ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Bodies:
    """The state from which the next physics step starts, and the body frames that brax's tasks read.

    The fields `q`, `qd`, `x` and `xd` have brax's names, because brax's observation and reward code reads them.
    B: bodies without the world. As after `mj_step`, `x` and `xd` belong to the start of the last substep.
    """

    q: jax.Array
    """[nq] positions of the joints."""
    qd: jax.Array
    """[nv] velocities of the joints."""
    x: Transform
    """[B, 3] position and [B, 4] rotation of each body in the world."""
    xd: Motion
    """[B, 3] angular and [B, 3] linear velocity of each body's frame in the world."""
    warmstart: jax.Array
    """[nv] accelerations with which the constraint solver starts."""
    scales: Scales = field(default_factory=dict)


class Engine(Protocol):
    """The physics of one simulation, without a batch axis: callers use `jax.vmap`."""

    name: str

    def reset(self, q: jax.Array, qd: jax.Array, scales: Scales) -> Any:
        """The state at joint positions `q` [nq] and velocities `qd` [nv], of a model with these factors."""
        ...

    def step(self, state: Any, ctrl: jax.Array) -> Any:
        """The state one environment step later, under actuator commands `ctrl` [nu]."""
        ...

    def seconds(self) -> float | None:
        """Seconds spent in physics so far, or None if they cannot be separated from the rest."""
        ...


class Layout(Protocol):
    """The fields of MuJoCo's data that a state consists of, and how either engine's results become one.

    `carried`: fields that are loaded before a step and kept after it, beside qpos, qvel and qacc_warmstart.
    """

    carried: tuple[str, ...]

    def first(self) -> tuple[np.ndarray, ...]:
        """The carried fields of a first state."""
        ...

    def carried_of(self, state: Any) -> tuple[jax.Array, ...]:
        """The carried fields of a state."""
        ...

    def shapes(self) -> Sequence[tuple[int, ...]]:
        """The shapes of one simulation's results, in the order of `bind`."""
        ...

    def bind(self, batch: Any) -> WriteFields:
        """Bind fields of the native engine's batch; returns what writes them into results, [N, ...] float32."""
        ...

    def state(self, results: Sequence[jax.Array], scales: Scales) -> Any:
        """The state of one simulation from the native engine's results."""
        ...

    def state_of(self, data: Any, scales: Scales) -> Any:
        """The state of one simulation from an `mjx.Data`."""
        ...


class FrameLayout:
    """`Bodies`: joint positions and velocities, warm start, and the frames of all bodies."""

    carried: tuple[str, ...] = ()

    def __init__(self, model: Any) -> None:
        """`model`: an `MjModel`, or its counterpart in JAX."""
        self._sizes = model.nq, model.nv, model.nbody - 1
        self._root = model.body_rootid[1:]

    def first(self) -> tuple[np.ndarray, ...]:
        return ()

    def carried_of(self, state: Bodies) -> tuple[jax.Array, ...]:
        return ()

    def shapes(self) -> Sequence[tuple[int, ...]]:
        positions, velocities, bodies = self._sizes
        return (positions,), (velocities,), (bodies, 3), (bodies, 4), (bodies, 6), (bodies, 3), (velocities,)

    def bind(self, batch: Any) -> WriteFields:
        names = ("qpos", "qvel", "qacc_warmstart", "xpos", "xquat", "cvel", "subtree_com")
        qpos, qvel, warmstart, xpos, xquat, cvel, subtree_com = (batch.bind(name) for name in names)
        frames = xpos[:, 1:]
        fields = qpos, qvel, frames, xquat[:, 1:], cvel[:, 1:], warmstart
        root = batch.model.body_rootid[1:]
        # A slice, where all bodies belong to one tree, is subtracted without being gathered first.
        root = slice(root[0], root[0] + 1) if (root == root[0]).all() else root

        def write(results: Sequence[np.ndarray]) -> None:
            *others, lever, solved = results
            for result, values in zip((*others, solved), fields, strict=True):
                result[:] = values
            np.subtract(frames, subtree_com[:, root], out=lever, casting="same_kind")

        return write

    def state(self, results: Sequence[jax.Array], scales: Scales) -> Bodies:
        q, qd, xpos, xquat, cvel, lever, warmstart = results
        return bodies_from(q, qd, xpos, xquat, cvel, lever, warmstart, scales)

    def state_of(self, data: Any, scales: Scales) -> Bodies:
        return bodies_from(
            q=data.qpos,
            qd=data.qvel,
            xpos=data.xpos[1:],
            xquat=data.xquat[1:],
            cvel=data.cvel[1:],
            lever=data.xpos[1:] - data.subtree_com[self._root],
            warmstart=data.qacc_warmstart,
            scales=scales,
        )


def bodies_from(
    q: jax.Array,
    qd: jax.Array,
    xpos: jax.Array,
    xquat: jax.Array,
    cvel: jax.Array,
    lever: jax.Array,
    warmstart: jax.Array,
    scales: Scales,
) -> Bodies:
    """`Bodies` from MuJoCo's fields.

    Args:
        xpos, xquat: [B, 3], [B, 4] frames of the bodies.
        cvel: [B, 6] velocity, angular first, taken at the centre of mass of the kinematic tree.
        lever: [B, 3] from that centre to the origin of the body's frame, at which brax expects the velocity.
    """
    at_tree = Motion(ang=cvel[:, :3], vel=cvel[:, 3:])
    xd = Transform.create(pos=lever).vmap().do(at_tree)
    return Bodies(q=q, qd=qd, x=Transform(pos=xpos, rot=xquat), xd=xd, warmstart=warmstart, scales=scales)
