"""MuJoCo's own warnings: which of them mean that a simulation diverged, and where all of them are sent."""

from __future__ import annotations

import logging

import mujoco

DIVERGED = [
    int(warning)
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
        mujoco.mjtWarning.mjWARN_BADCTRL,
    )
]
"""Warnings after which a simulation has diverged: MuJoCo reset its state or dropped its commands."""

_LOG = logging.getLogger("mujoco")


def log_instead_of_printing() -> None:
    """Send MuJoCo's warnings to the logger "mujoco" at level DEBUG, unless the program has its own handler.

    By default they go to stderr and to a file MUJOCO_LOG.TXT in the current folder. Diverged simulations are reported
    by `EnvState.diverged`.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_LOG.debug)
