"""Imports brax and MuJoCo's JAX engine without their announcements.

The only module of this package that imports brax and `mujoco.mjx`. A shim for a function that a newer JAX has removed
would belong here; the parts of brax that are used need none (JAX 0.10).
"""

from __future__ import annotations

import contextlib
import io
import warnings
from typing import Any

from common.physics.mujoco_log import log_instead_of_printing

_ANNOUNCEMENTS = ("Brax System, piplines and environments are not", "JAXopt is no longer maintained")


@contextlib.contextmanager
def without_announcements() -> Any:
    """Suppress the warnings that brax and a library it imports are no longer developed, and no others."""
    with warnings.catch_warnings():
        for announcement in _ANNOUNCEMENTS:
            warnings.filterwarnings("ignore", message=announcement)
        yield


# mujoco.mjx prints that its optional Warp engine is not installed.
with without_announcements(), contextlib.redirect_stdout(io.StringIO()):
    from brax import envs
    from brax.base import Motion, Transform
    from mujoco import mjx

__all__ = ["Motion", "Transform", "envs", "log_instead_of_printing", "mjx", "without_announcements"]
