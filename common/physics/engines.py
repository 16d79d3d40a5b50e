"""The names of the physics engines and the rule that chooses one.

| name | engine | best on |
| --- | --- | --- |
| `native` | MuJoCo's C engine on a pool of threads | machines without an accelerator |
| `mjx` | MuJoCo's JAX engine, compiled with the policy | GPUs and TPUs |
| `auto` | `mjx` if JAX's default backend is an accelerator, else `native` | all machines |

Importing this module loads neither engine, so that a setting can be checked without them.
"""

from __future__ import annotations

import jax
from jax._src.xla_bridge import backends_are_initialized

from common.engine_names import AUTO, MJX, NATIVE, PHYSICS
from common.errors import PhysicsError, SettingsError
from common.suggestions import unknown_name

_ASYNCHRONOUS = "jax_cpu_enable_async_dispatch"


def resolve_physics(physics: str) -> str:
    """The engine that `physics` selects on this machine: "mjx" or "native".

    "auto" initialises JAX's backends if nothing has yet, with synchronous dispatch for the native engine.

    Raises:
        SettingsError: `physics` is not one of `PHYSICS`.
    """
    if physics not in PHYSICS:
        raise SettingsError(unknown_name("physics engine", physics, PHYSICS))
    if physics != AUTO:
        return physics
    if not backends_are_initialized():
        jax.config.update(_ASYNCHRONOUS, False)
    return NATIVE if jax.default_backend() == "cpu" else MJX


def require_synchronous_dispatch() -> None:
    """Make JAX run CPU programs on the calling thread, as the native engine requires.

    By default JAX runs them on a pool with one thread per core. A program that waits there for the native engine
    occupies its thread, while large arguments of the engine are copied by the same pool: with one core, or with as many
    programs as cores, each waits for the other for ever.

    Raises:
        PhysicsError: JAX's backends are already initialised with asynchronous dispatch.
    """
    if not jax.config.read(_ASYNCHRONOUS):
        return
    if backends_are_initialized():
        raise PhysicsError(
            "physics 'native' was requested after JAX had started with asynchronous dispatch on the CPU, with which "
            "a program can wait for ever; call common.physics.engines.require_synchronous_dispatch() before JAX is "
            "first used, or set JAX_CPU_ENABLE_ASYNC_DISPATCH=0 in the environment of the process"
        )
    jax.config.update(_ASYNCHRONOUS, False)
