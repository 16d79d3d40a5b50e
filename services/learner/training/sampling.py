"""Whether a policy can be sampled from, in the precision that actors sample in."""

from __future__ import annotations

import numpy as np

FARTHEST_DRAW = 8.0
"""Standard deviations that no float32 draw from a normal distribution lies beyond: those of JAX end below 6."""


def sampling_problem(log_std: np.ndarray) -> str | None:
    """Why actions with these log standard deviations [A] would not be finite in float32; None where they are.

    The log-probability of an action divides by the standard deviation, so its inverse must be finite as well.
    """
    with np.errstate(over="ignore"):
        std, inverse = np.exp(log_std, dtype=np.float32), np.exp(-log_std, dtype=np.float32)
        possible = np.isfinite(std * np.float32(FARTHEST_DRAW)) & np.isfinite(inverse)
    if possible.all():
        return None
    worst = int(np.argmin(possible))
    return (
        f"log_std of action {worst} is {log_std[worst]:.4g}: its standard deviation {std[worst]:.3g} is too "
        f"{'large' if log_std[worst] > 0 else 'small'} for float32"
    )
