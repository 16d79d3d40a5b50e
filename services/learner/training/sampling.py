"""Checks that a policy can be sampled from: in float32, and with actions that a rollout may hold."""

from __future__ import annotations

import numpy as np

from common.wire.rollout import MAX_MAGNITUDE

FARTHEST_DRAW = 8.0
"""Standard deviations that no float32 draw from a normal distribution lies beyond: those of JAX end below 6."""


def sampling_problem(log_std: np.ndarray) -> str | None:
    """The reason why actions with these log standard deviations [A] could not be used; None where they can.

    A draw must not be larger than a number of a rollout may be, or the learner would refuse what its own policy makes.
    The log-probability of an action divides by the standard deviation, so its inverse must be finite in float32.
    """
    with np.errstate(over="ignore"):
        std, inverse = np.exp(log_std, dtype=np.float32), np.exp(-log_std, dtype=np.float32)
        possible = (std * np.float32(FARTHEST_DRAW) <= MAX_MAGNITUDE) & np.isfinite(inverse)
    if possible.all():
        return None
    worst = int(np.argmin(possible))
    limit = f"too large for actions up to {MAX_MAGNITUDE:g}" if log_std[worst] > 0 else "too small for float32"
    return f"log_std of action {worst} is {log_std[worst]:.4g}: its standard deviation {std[worst]:.3g} is {limit}"
