"""MuJoCo's JAX engine, which is compiled into one program with its caller; for accelerators."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from common.physics.bodies import WITHOUT_MJX, FrameLayout, Layout, Scales
from common.physics.engines import MJX
from common.physics.libraries import mjx
from common.physics.randomisation import scaled_fields


class MjxEngine:
    """Steps one simulation with `mujoco.mjx`, in float32.

    Every step starts from a new `mjx.Data`. The state holds all that is carried from step to step, so that it
    has a few hundred numbers instead of the thousands of intermediate results in `mjx.Data`.
    """

    name = MJX

    def __init__(self, system: Any, substeps: int, layout: Layout | None = None) -> None:
        """`system`: the task's `mjx.Model`, such as a `brax.System`; `substeps`: MuJoCo steps per environment step.

        `layout`: of the states.
        """
        self._system = system
        self._substeps = substeps
        self._layout = layout or FrameLayout(system)

    def reset(self, q: jax.Array, qd: jax.Array, scales: Scales | None = None) -> Any:
        system = self._scaled(scales or {})
        with jax.default_matmul_precision("highest"):
            data = mjx.make_data(self._system).replace(qpos=q, qvel=qd)
            return self._layout.state_of(mjx.forward(system, data), scales or {})

    def step(self, state: Any, ctrl: jax.Array) -> Any:
        system = self._scaled(state.scales)
        carried = dict(zip(self._layout.carried, self._layout.carried_of(state), strict=True))
        known = {name: value for name, value in carried.items() if name not in WITHOUT_MJX}
        data = mjx.make_data(self._system).replace(
            qpos=state.q, qvel=state.qd, ctrl=ctrl, qacc_warmstart=state.warmstart, **known
        )
        # By default GPUs multiply float32 matrices with 10-bit mantissas, which is too coarse for the solver.
        with jax.default_matmul_precision("highest"):
            data, _ = jax.lax.scan(lambda d, _: (mjx.step(system, d), None), data, length=self._substeps)
        return self._layout.state_of(data, state.scales)

    def seconds(self) -> None:
        """None: physics is part of one compiled program."""
        return None

    def _scaled(self, scales: Scales) -> Any:
        return self._system.replace(**dict(scaled_fields(self._system, scales, jnp))) if scales else self._system
