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

from common.errors import SettingsError
from common.tasks import unknown_name

AUTO: Final = "auto"
MJX: Final = "mjx"
NATIVE: Final = "native"
PHYSICS: Final = (AUTO, MJX, NATIVE)


def resolve_physics(physics: str) -> str:
    """The engine that `physics` stands for on this machine: "mjx" or "native".

    Raises:
        SettingsError: `physics` is none of `PHYSICS`.
    """
    if physics not in PHYSICS:
        raise SettingsError(unknown_name("physics engine", physics, PHYSICS))
    if physics != AUTO:
        return physics
    return NATIVE if jax.default_backend() == "cpu" else MJX
