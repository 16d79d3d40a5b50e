"""MuJoCo's JAX engine: compiled together with whatever calls it, best on an accelerator."""

from __future__ import annotations

from typing import Any

import jax

from common.physics.bodies import Bodies, bodies_from
from common.physics.engines import MJX
from common.physics.libraries import mjx


class MjxEngine:
    """Steps one simulation with `mujoco.mjx`, in float32.

    Every step starts from a fresh `mjx.Data`. All that the eight models carry over is in `Bodies`, so that a
    state is a few hundred numbers and not the thousands of intermediate results in `mjx.Data`.
    """

    name = MJX

    def __init__(self, system: Any, substeps: int) -> None:
        """`system` is the `brax.System` (an `mjx.Model`) of the task; `substeps` are MuJoCo's steps in each of its."""
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
        # GPUs multiply float32 matrices with 10-bit mantissas unless told otherwise, too few for a solver.
        with jax.default_matmul_precision("highest"):
            data, _ = jax.lax.scan(lambda d, _: (mjx.step(self._system, d), None), data, length=self._substeps)
        return self._bodies(data)

    def seconds(self) -> None:
        """None: XLA compiles physics into one program with the rest."""
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
