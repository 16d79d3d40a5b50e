"""The state that both engines carry from step to step, and the interface they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import jax

from common.physics.libraries import Motion, Transform


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Bodies:
    """The state from which the next physics step starts, and the body frames that the tasks read.

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


class Engine(Protocol):
    """The physics of one simulation, without a batch axis: callers use `jax.vmap`."""

    name: str

    def reset(self, q: jax.Array, qd: jax.Array) -> Bodies:
        """The bodies at joint positions `q` [nq] and velocities `qd` [nv]."""
        ...

    def step(self, bodies: Bodies, ctrl: jax.Array) -> Bodies:
        """The bodies one environment step later, under actuator commands `ctrl` [nu]."""
        ...

    def seconds(self) -> float | None:
        """Seconds spent in physics so far, or None if they cannot be separated from the rest."""
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
    """`Bodies` from MuJoCo's fields.

    Args:
        xpos, xquat: [B, 3], [B, 4] frames of the bodies.
        cvel: [B, 6] velocity, angular first, taken at the centre of mass of the kinematic tree.
        lever: [B, 3] from that centre to the origin of the body's frame, at which brax expects the velocity.
    """
    at_tree = Motion(ang=cvel[:, :3], vel=cvel[:, 3:])
    xd = Transform.create(pos=lever).vmap().do(at_tree)
    return Bodies(q=q, qd=qd, x=Transform(pos=xpos, rot=xquat), xd=xd, warmstart=warmstart)
