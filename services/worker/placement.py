"""The device of a worker's programs: those that call the native engine are computed on the CPU."""

from __future__ import annotations

import jax

from common.engine_names import NATIVE
from common.errors import PhysicsError


def compute_beside(physics: str) -> None:
    """Have all programs from now on computed where the engine is: on the CPU for `native`, else on JAX's own choice.

    An actor learns the run's engine only when it joins, and JAX has started by then, perhaps on a GPU. There, every
    step would be copied to the CPU and back.

    Raises:
        PhysicsError: JAX was started without a CPU.
    """
    if jax.default_backend() == "cpu":
        return
    jax.config.update("jax_default_device", _cpu() if physics == NATIVE else None)


def _cpu() -> jax.Device:
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        raise PhysicsError(
            "physics 'native' is computed on the CPU, which JAX_PLATFORMS excludes in the environment of this process; "
            "leave the variable out, or add cpu to it, as in JAX_PLATFORMS=cuda,cpu"
        ) from None
