"""The state that both engines carry from step to step, and the interface they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import jax

from common.physics.libraries import Motion, Transform


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Bodies:
    """What the next physics step starts from, and what the tasks read from the last one.

    The fields `q`, `qd`, `x` and `xd` have brax's names, for brax's observation and reward code reads them.
    B = bodies without the world. As after `mj_step`, `x` and `xd` belong to the start of the last substep.
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
    """[nv] accelerations from which the constraint solver starts."""


class Engine(Protocol):
    """One simulation's physics, written without a batch axis: callers use `jax.vmap`."""

    name: str

    def reset(self, q: jax.Array, qd: jax.Array) -> Bodies:
        """The bodies at joint positions `q` [nq] and velocities `qd` [nv]."""
        ...

    def step(self, bodies: Bodies, ctrl: jax.Array) -> Bodies:
        """The bodies one environment step later, under actuator commands `ctrl` [nu]."""
        ...

    def seconds(self) -> float | None:
        """Seconds spent in physics so far, or None where they cannot be told from the rest."""
        ...


def bodies_from(
    q: jax.Array,
    qd: jax.Array,
    xpos: jax.Array,
    xquat: jax.Array,
    cvel: jax.Array,
    lever: jax.Array,
    warmstart: jax.Array,
) -> Bodies:
    """MuJoCo's fields as `Bodies`.

    Args:
        xpos, xquat: [B, 3], [B, 4] frames of the bodies.
        cvel: [B, 6] velocity, angular first, taken at the centre of mass of the kinematic tree.
        lever: [B, 3] from that centre to the frame of the body, to which the velocity is moved.
    """
    at_tree = Motion(ang=cvel[:, :3], vel=cvel[:, 3:])
    xd = Transform.create(pos=lever).vmap().do(at_tree)
    return Bodies(q=q, qd=qd, x=Transform(pos=xpos, rot=xquat), xd=xd, warmstart=warmstart)
