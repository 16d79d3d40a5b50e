"""Comparison of the rollouts that the actors of a resumed run make again with those of its log."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields

import numpy as np

from common.wire.rollout import Rollout, RolloutId


class Comparison:
    """Compares the rollouts of one version at a time; `divergence` is the first difference, None without any."""

    def __init__(self) -> None:
        self._logged: dict[RolloutId, Rollout] = {}
        self.divergence: str | None = None

    def begin(self, logged: Collection[Rollout]) -> None:
        """Compare with these from now on. Without any, nothing can diverge: all that is made is new."""
        self._logged = {rollout.id: rollout for rollout in logged}
        if not logged:
            self.divergence = None

    def logged(self, identity: RolloutId, made: Rollout) -> Rollout | None:
        """The logged rollout to use in place of one that was made again; None where the log has none."""
        logged = self._logged.get(identity)
        if logged is not None and (what := first_divergence(logged, made)):
            self._diverge(f"rollout {made.seq} of slot {made.slot}, version {made.policy_version}: {what}")
        return logged

    def actor_lost(self, slot: int) -> None:
        """Note that a slot has lost its actor: its successor begins with other environments."""
        if self._logged:
            self._diverge(f"slot {slot} lost its actor before all was made again")

    def _diverge(self, what: str) -> None:
        self.divergence = self.divergence or what


def first_divergence(logged: Rollout, made: Rollout) -> str | None:
    """The first difference between two rollouts of one id, bit for bit; None without any.

    The time of sending, the incarnation and the timing may differ.
    """
    if logged.policy_version != made.policy_version:
        return f"policy {logged.policy_version} acted in the log, policy {made.policy_version} now"
    for field in fields(Rollout):
        old, new = getattr(logged, field.name), getattr(made, field.name)
        if not isinstance(old, np.ndarray):
            continue
        if old.shape != new.shape:
            return f"{field.name} has shape {list(old.shape)} in the log and {list(new.shape)} now"
        bits = np.ascontiguousarray(old).view(np.uint8) != np.ascontiguousarray(new).view(np.uint8)
        if bits.any():
            where = tuple(int(i) for i in np.argwhere(bits.reshape(*old.shape, old.itemsize).any(-1))[0])
            return f"{field.name}{list(where)} is {old[where]!s} in the log and {new[where]!s} now"
    return None
