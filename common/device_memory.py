"""The variables by which JAX, when it starts in a process, learns which devices and how much of a GPU's memory to take.

By default JAX reserves three quarters of a GPU for every process, so that of a learner and an actor on one GPU the
second fails. Here a process reserves nothing unless it is given a share. JAX reads these variables once, so they are
set before it is imported. This module does not import it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, Literal

from common.engine_names import NATIVE
from common.errors import SettingsError

if TYPE_CHECKING:
    from common.config.settings import RunSettings

ON_DEMAND: Final = "on-demand"
"""In place of a share: nothing is reserved, and memory is taken as programs need it."""

PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"
FRACTION = "XLA_CLIENT_MEM_FRACTION"
OLD_FRACTION = "XLA_PYTHON_CLIENT_MEM_FRACTION"
"""The former name of `FRACTION`; JAX refuses to start with both."""
PLATFORMS = "JAX_PLATFORMS"


def with_share(environment: Mapping[str, str], share: float | Literal["on-demand"]) -> dict[str, str]:
    """The environment of a process that may take this share of a GPU's memory.

    A share takes precedence over what the environment says of preallocation; on demand, that is kept.
    """
    if share == ON_DEMAND:
        decided = any(name in environment for name in (PREALLOCATE, FRACTION, OLD_FRACTION))
        return dict(environment) if decided else {**environment, PREALLOCATE: "false"}
    kept = {name: value for name, value in environment.items() if name != OLD_FRACTION}
    return {**kept, PREALLOCATE: "true", FRACTION: f"{share:g}"}


def worker_environment(
    environment: Mapping[str, str], physics: str, share: float | Literal["on-demand"]
) -> dict[str, str]:
    """The environment of an actor or evaluator: with the native engine it computes on the CPU and takes no GPU."""
    if physics == NATIVE:
        return {**environment, PLATFORMS: "cpu"}
    return with_share(environment, share)


def adopt(environment: Mapping[str, str]) -> None:
    """Make this the environment of this process. To be called before JAX is imported."""
    for name in set(os.environ) - set(environment):
        del os.environ[name]
    os.environ.update(environment)


def reserve(share: float | Literal["on-demand"]) -> None:
    """Limit this process to a share of a GPU's memory. To be called before JAX starts."""
    adopt(with_share(os.environ, share))


def require_room(settings: RunSettings) -> None:
    """Refuse shares of a learner and its actors on one machine that are more than its GPU.

    Raises:
        SettingsError: with the sum.
    """
    memory = settings.device_memory
    learner = 0.0 if memory.learner == ON_DEMAND else memory.learner
    actors = 0.0 if memory.actor == ON_DEMAND or settings.physics == NATIVE else settings.actors * memory.actor
    if learner + actors > 1.0 + 1e-9:
        raise SettingsError(
            f"device_memory.learner ({memory.learner}) and device_memory.actor ({memory.actor}) of {settings.actors} "
            f"actors make {learner + actors:g} of the GPU that they share; choose less than 1 together, or {ON_DEMAND}"
        )
