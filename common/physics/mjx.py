"""MuJoCo's JAX engine, which is compiled into one program with its caller; for accelerators."""

from __future__ import annotations

from typing import Any

import jax

from common.physics.bodies import Bodies, bodies_from
from common.physics.engines import MJX
from common.physics.libraries import mjx


class MjxEngine:
    """Steps one simulation with `mujoco.mjx`, in float32.

    Every step starts from a new `mjx.Data`. `Bodies` holds all that the eight models carry from step to step, so that a
    state has a few hundred numbers instead of the thousands of intermediate results in `mjx.Data`.
    """

    name = MJX

    def __init__(self, system: Any, substeps: int) -> None:
        """`system` is the `brax.System` (an `mjx.Model`) of the task; `substeps`: MuJoCo steps per environment step."""
        self._system = system
        self._substeps = substeps

    def reset(self, q: jax.Array, qd: jax.Array) -> Bodies:
        with jax.default_matmul_precision("highest"):
            data = mjx.make_data(self._system).replace(qpos=q, qvel=qd)
            return self._bodies(mjx.forward(self._system, data))

    def step(self, bodies: Bodies, ctrl: jax.Array) -> Bodies:
        data = mjx.make_data(self._system).replace(
            qpos=bodies.q, qvel=bodies.qd, ctrl=ctrl, qacc_warmstart=bodies.warmstart
        )
        # By default GPUs multiply float32 matrices with 10-bit mantissas, which is too coarse for the solver.
        with jax.default_matmul_precision("highest"):
            data, _ = jax.lax.scan(lambda d, _: (mjx.step(self._system, d), None), data, length=self._substeps)
        return self._bodies(data)

    def seconds(self) -> None:
        """None: physics is part of one compiled program."""
        return None

    def _bodies(self, data: Any) -> Bodies:
        root = self._system.body_rootid[1:]
        return bodies_from(
            q=data.qpos,
            qd=data.qvel,
            xpos=data.xpos[1:],
            xquat=data.xquat[1:],
            cvel=data.cvel[1:],
            lever=data.xpos[1:] - data.subtree_com[root],
            warmstart=data.qacc_warmstart,
        )
