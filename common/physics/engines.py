"""The names of the physics engines and the rule that chooses one.

| name | what it is | where it is the right one |
| --- | --- | --- |
| `native` | MuJoCo's C engine on a pool of threads | a machine without an accelerator |
| `mjx` | MuJoCo's JAX engine, compiled with the policy | a GPU or a TPU |
| `auto` | `mjx` where JAX's default backend is an accelerator, else `native` | everywhere |

Importing this module loads neither engine: a setting can be checked without them.
"""

from __future__ import annotations

from typing import Final

import jax
from jax._src.xla_bridge import backends_are_initialized

from common.errors import PhysicsError, SettingsError
from common.tasks import unknown_name

AUTO: Final = "auto"
MJX: Final = "mjx"
NATIVE: Final = "native"
PHYSICS: Final = (AUTO, MJX, NATIVE)

_ASYNCHRONOUS = "jax_cpu_enable_async_dispatch"


def resolve_physics(physics: str) -> str:
    """The engine that `physics` stands for on this machine: "mjx" or "native".

    To answer for "auto" JAX has to start, if it has not yet; it is prepared for the native engine first.

    Raises:
        SettingsError: `physics` is none of `PHYSICS`.
    """
    if physics not in PHYSICS:
        raise SettingsError(unknown_name("physics engine", physics, PHYSICS))
    if physics != AUTO:
        return physics
    if not backends_are_initialized():
        jax.config.update(_ASYNCHRONOUS, False)
    return NATIVE if jax.default_backend() == "cpu" else MJX


def prepare_jax() -> None:
    """Have JAX run its CPU programs in the thread that calls them, as the native engine needs.

    By default JAX hands them to a pool with a thread for every core. A program that waits there for the native
    engine keeps its thread, while the engine's arguments, once they are large, are copied by the same pool: with one
    core, or with as many programs as cores, each waits for the other for ever.

    Raises:
        PhysicsError: JAX has been used already, so that the choice is made.
    """
    if not jax.config.read(_ASYNCHRONOUS):
        return
    if backends_are_initialized():
        raise PhysicsError(
            "physics 'native' was asked for after JAX had started with asynchronous dispatch on the CPU, with which "
            "a program can wait for ever; call common.physics.engines.prepare_jax() before JAX is first used, or set "
            "JAX_CPU_ENABLE_ASYNC_DISPATCH=0 in the environment of the process"
        )
    jax.config.update(_ASYNCHRONOUS, False)
