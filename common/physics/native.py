"""MuJoCo's C engine on a pool of threads, called by JAX once for the whole batch."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from common.cores import usable_cores
from common.errors import PhysicsError
from common.physics.bodies import FrameLayout, Layout, Scales
from common.physics.engines import NATIVE
from common.physics.host_functions import HostFunction
from common.physics.mujoco_log import DIVERGED
from common.physics.randomisation import scaled_fields


class NativeEngine:
    """Steps `num_envs` simulations of one model with `mujoco.batch`, in float64 between float32 states.

    `reset` and `step` are written for one simulation, as tasks are, and must be mapped with `jax.vmap` over
    exactly `num_envs` of them; the map turns them into one call on the host for the batch. A call loads each
    simulation's complete state, so that results depend on the arguments alone, not on earlier calls or the number of
    threads.

    MuJoCo resets a simulation whose state is not finite or exceeds 1e10 to the model's defaults. Its state is reported
    as NaN here, as with `mjx`, so that the caller notices.
    """

    name = NATIVE

    def __init__(
        self, model: mujoco.MjModel, substeps: int, num_envs: int, threads: int, layout: Layout | None = None
    ) -> None:
        """`threads` includes the calling thread; 0 is one per core that this process may use. `layout`: of the states.

        Raises:
            PhysicsError: the installed MuJoCo has no batch engine.
        """
        make_batch, self._failure = _batch_engine()
        workers = min(threads or usable_cores(), num_envs)
        self._make_batch = functools.partial(make_batch, model, num_envs, workers)
        self._layout = layout or FrameLayout(model)
        self._substeps = substeps
        self._sizes = model.nu, model.nv
        self._seconds = 0.0
        self._functions: dict[tuple[str, ...], HostFunction] = {}
        # Programs on different threads may share this engine, but a batch serves one caller at a time.
        self._lock = threading.Lock()

    @functools.cached_property
    def _arrays(self) -> _BatchArrays:
        """The batch with its arrays, made in the first call on the host.

        XLA makes these calls with denormal numbers flushed to zero. The batch's threads take over the mode of the
        thread that starts them; started anywhere else, they would treat denormals differently from the calling thread,
        which steps simulations as well, and results would depend on which thread steps which simulation.
        """
        return _BatchArrays(self._make_batch(), self._layout)

    def reset(self, q: jax.Array, qd: jax.Array, scales: Scales | None = None) -> Any:
        commands, velocities = self._sizes
        first = (jnp.asarray(field, jnp.float32) for field in self._layout.first())
        return self._call(self._forward, (q, qd, jnp.zeros(commands), jnp.zeros(velocities), *first), scales or {})

    def step(self, state: Any, ctrl: jax.Array) -> Any:
        carried = self._layout.carried_of(state)
        return self._call(self._advance, (state.q, state.qd, ctrl, state.warmstart, *carried), state.scales)

    def seconds(self) -> float:
        """Seconds spent inside MuJoCo's batch calls so far."""
        return self._seconds

    def _call(self, run: Callable[[Any], None], inputs: Sequence[jax.Array], scales: Scales) -> Any:
        known = (run.__name__, *scales)
        if known not in self._functions:
            self._functions[known] = HostFunction(functools.partial(self._on_host, run, tuple(scales)))
        results = self._functions[known]((*inputs, *scales.values()), self._layout.shapes())
        return self._layout.state(results, scales)

    def _on_host(
        self,
        run: Callable[[Any], None],
        scaled: tuple[str, ...],
        inputs: Sequence[np.ndarray],
        results: Sequence[np.ndarray],
    ) -> None:
        """Run `run` on the batch, into [N, ...] results.

        `inputs`: qpos [N, nq], qvel [N, nv], ctrl [N, nu], warm start [N, nv], what is carried, and the factors [N] of
        what is `scaled`.
        """
        with self._lock:
            arrays = self._arrays
            state = inputs[: len(inputs) - len(scaled)]
            arrays.load(state, dict(zip(scaled, inputs[len(state) :], strict=True)))
            lost = self._timed(run, arrays.batch)
            arrays.write(results)
        if lost.any():
            for result in results:
                result[lost] = np.nan

    def _timed(self, run: Callable[[Any], None], batch: Any) -> np.ndarray:
        """Run the batch; returns the simulations [N] (bool) that diverged."""
        started = time.perf_counter()
        try:
            run(batch)
        except self._failure:
            pass  # `status` says which simulations failed; all others ran to the end
        finally:
            self._seconds += time.perf_counter() - started
        return (batch.status != 0) | batch.warning[:, DIVERGED, 1].any(axis=1)

    def _forward(self, batch: Any) -> None:
        batch.forward()

    def _advance(self, batch: Any) -> None:
        batch.step(nstep=self._substeps)


class _BatchArrays:
    """A batch and its arrays on the host."""

    def __init__(self, batch: Any, layout: Layout) -> None:
        self.batch = batch
        # Steps change these and the inputs; all else in the state stays as it is, or is set to the model's default
        # by MuJoCo where a simulation diverged.
        changing = ("time", "act", "history", "plugin_state", "plastic")
        self._rest = [batch.bind(name) for name in changing if name not in layout.carried]
        self._defaults = [field.copy() for field in self._rest]
        self._inputs = [batch.bind(name) for name in ("qpos", "qvel", "ctrl", "qacc_warmstart", *layout.carried)]
        self.write = layout.bind(batch)

    def load(self, inputs: Sequence[Any], scales: dict[str, Any]) -> None:
        """Set the complete state of each simulation, the defaults and `inputs`, and its randomised model fields."""
        for field, default in zip(self._rest, self._defaults, strict=True):
            field[:] = default
        self.batch.warning[:] = 0
        for field, given in zip(self._inputs, inputs, strict=True):
            field[:] = given
        for name, values in scaled_fields(self.batch.model, scales, np):
            self.batch.expand(name)[:] = values


def _batch_engine() -> tuple[Callable[[mujoco.MjModel, int, int], Any], type[RuntimeError]]:
    """MuJoCo's batch class, and the exception that its calls raise when simulations fail."""
    try:
        from mujoco.batch import Batch, SimulationError
    except ImportError as error:
        raise PhysicsError(
            f"physics 'native' needs MuJoCo's batch engine, which mujoco {mujoco.__version__} does not have; "
            "install mujoco 4.0 or later, or choose physics 'mjx'"
        ) from error
    return Batch, SimulationError
