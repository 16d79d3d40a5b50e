"""What the actors of a resumed run make again, beside what its log holds of the same version."""

from __future__ import annotations

from collections.abc import Collection

from common.wire.messages import Rollout
from services.learner.slots import Place
from services.learner.tail import difference


class Comparison:
    """Of one version at a time. `departure` says why what is made is not what is logged; None while it is the same."""

    def __init__(self) -> None:
        self._logged: dict[Place, Rollout] = {}
        self.departure: str | None = None

    def begin(self, logged: Collection[Rollout]) -> None:
        """Compare with these from now on. Without any, nothing can depart: all that is made is new."""
        self._logged = {rollout.place: rollout for rollout in logged}
        if not logged:
            self.departure = None

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
        self.departure = self.departure or what
