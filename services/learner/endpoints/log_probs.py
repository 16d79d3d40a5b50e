"""Bounds of the log-probabilities in a rollout: those of draws from the policy that acted.

An update takes the exponential of the difference between a new log-probability and the recorded one. A recorded one
that is far too small makes that infinite, and the whole update with it, from numbers that are all within bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from common.errors import CodecError
from common.wire.rollout import Rollout

LOG_STD = "parameters/log_std"
"""Path of the log standard deviations among the arrays of a policy."""

VERSIONS = 8
"""Policies that are kept: rollouts are made with the newest, or with one that is as little behind as staleness."""

_RARE = 40.0
"""A draw beyond the bound has a probability of less than exp(-40)."""

_SLACK = 1.0
_ROUNDING = 2.0**-21
"""Relative error of the distance between an action and its mean in float32, with a margin of two bits."""


def farthest(actions: int) -> float:
    """The squared distance from the mean, in standard deviations, that no draw of so many action dimensions exceeds.

    Laurent and Massart's bound of the chi-squared distribution.
    """
    return actions + 2.0 * math.sqrt(actions * _RARE) + 2.0 * _RARE


class LogProbabilityCheck:
    """Holds rollouts against the log standard deviations of the newest policies. Not thread-safe."""

    def __init__(self) -> None:
        self._log_std: dict[int, np.ndarray] = {}

    def published(self, version: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Note a policy that rollouts may be made with from now on."""
        if LOG_STD in arrays:
            self._log_std[version] = np.asarray(arrays[LOG_STD], np.float64)
        for old in sorted(self._log_std)[:-VERSIONS]:
            del self._log_std[old]

    def log_std(self, version: int) -> np.ndarray | None:
        """The log standard deviations of a policy; None for one that is not kept."""
        return self._log_std.get(version)


def check_log_probs(rollout: Rollout, log_std: np.ndarray | None) -> None:
    """Raise CodecError("bad_log_prob") for a log-probability that no draw has. Nothing is checked without `log_std`."""
    if log_std is None or not rollout.log_prob.size:
        return
    most = -float(log_std.sum()) - 0.5 * log_std.size * math.log(2.0 * math.pi)
    # Where the deviation is tiny beside the action, an honest distance is off by what float32 rounds away.
    largest = np.abs(rollout.action).max(axis=(0, 1)).astype(np.float64)
    with np.errstate(over="ignore"):
        rounded = float(np.linalg.norm(_ROUNDING * largest * np.exp(-log_std)))
    least = most - 0.5 * (math.sqrt(farthest(log_std.size)) + rounded) ** 2
    low, high = float(rollout.log_prob.min()), float(rollout.log_prob.max())
    if low < least - _SLACK or high > most + _SLACK:
        raise CodecError(
            "bad_log_prob",
            f"log_prob goes from {low:.4g} to {high:.4g}; draws from policy {rollout.policy_version} have {least:.4g} "
            f"to {most:.4g}",
        )
