"""What the actors of a resumed run make again, beside what its log holds of the same version."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields

import numpy as np

from common.wire.messages import Rollout
from services.learner.scheduling.slots import Place


class Comparison:
    """Of one version at a time. `divergence` says why what is made is not what is logged; None while it is the same."""

    def __init__(self) -> None:
        self._logged: dict[Place, Rollout] = {}
        self.divergence: str | None = None

    def begin(self, logged: Collection[Rollout]) -> None:
        """Compare with these from now on. Without any, nothing can depart: all that is made is new."""
        self._logged = {rollout.place: rollout for rollout in logged}
        if not logged:
            self.divergence = None

    def logged(self, place: Place, made: Rollout) -> Rollout | None:
        """The rollout of the log to take for one that was made again; None where the log has none."""
        logged = self._logged.get(place)
        if logged is not None and (what := difference(logged, made)):
            self._depart(f"rollout {made.seq} of slot {made.slot}, version {made.policy_version}: {what}")
        return logged

    def lost(self, slot: int) -> None:
        """A slot has lost the actor that acted again: its successor begins with other environments."""
        if self._logged:
            self._depart(f"slot {slot} lost its actor before all was made again")

    def _depart(self, what: str) -> None:
        self.divergence = self.divergence or what


def difference(logged: Rollout, made: Rollout) -> str | None:
    """What differs first between two rollouts of one place, bit for bit; None where nothing does.

    When they were sent, by whom and how long they took does not count.
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
