"""The batch of sync mode: one rollout of the current version from every slot, whatever the timing.

While a slot has lost its actor, another brings its rollout. A slot that nobody has held yet is waited for, so that a
run's first batch, and with it the whole run, is the same whichever actor comes first; unless that wait is over.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from common.wire.messages import PushReply, Rollout
from services.learner.scheduling.comparison import Comparison
from services.learner.scheduling.slots import ACCEPTED, Objection, Place, RolloutKey, Slot


class SyncBatch:
    """The rollouts of the version being collected. `slots` is the fleet's own list."""

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._slots = slots
        self._version = 0
        self._collecting = True
        self._settled: set[int] = set()
        self._comparison = Comparison()
        self._taken: dict[Place, Rollout] = {}
        self._extra: Counter[int] = Counter()
        self.under_way: dict[RolloutKey, Place] = {}

    @property
    def divergence(self) -> str | None:
        """Why what is made again is not what the log of a resumed run holds; None while it is the same."""
        return self._comparison.divergence

    @property
    def waits(self) -> bool:
        """Whether a slot that nobody has held yet is waited for."""
        return True

    def begin(
        self, version: int, *, collect: bool, logged: Collection[Rollout] = (), settled: Collection[Rollout] = ()
    ) -> list[Rollout]:
        """As `Fleet.begin`."""
        self._version = version
        self._collecting = collect
        self._comparison.begin(logged)
        self._taken.clear()
        self._settle(settled)
        self._extra.clear()
        return []

    def start_over(self, settled: Collection[Rollout], *, collect: bool) -> None:
        """As `Fleet.start_over`."""
        self._collecting = collect
        self._comparison.begin(())
        self._settle(settled)

    def objection(self, rollout: Rollout) -> Objection | None:
        """Why a rollout of the slot's own actor is of no use."""
        if rollout.policy_version != self._version or self.divergence is not None:
            return "stale", f"made with policy {rollout.policy_version}; policy {self._version} is wanted"
        if not self._collecting or len(self._taken) + len(self.under_way) >= len(self._slots):
            return "surplus", f"policy {self._version} has all the rollouts it needs"
        return None

    def admit(self, rollout: Rollout) -> PushReply | None:
        """None where it is to be logged, and is under way until then; accepted where the log has it already."""
        if (logged := self._comparison.logged(rollout.place, rollout)) is not None:
            self._taken[rollout.place] = logged
            return ACCEPTED
        self.under_way[rollout.key] = rollout.place
        return None

    def accept(self, rollout: Rollout) -> None:
        """It is in the log: it counts."""
        place = self.under_way.pop(rollout.key)
        if rollout.policy_version == self._version:
            self._taken[place] = rollout

    def take(self) -> list[Rollout] | None:
        """All rollouts of the version in (slot, generation, seq) order, once they are complete; else None."""
        if len(self._taken) < len(self._slots):
            return None
        return [self._taken[place] for place in sorted(self._taken)]

    def wanted(self, slot: int) -> int:
        """Rollouts that the slot's actor is to make in all under this version."""
        if not self._collecting or slot in self._settled:
            return 0
        return 1 + self._extra[slot]

    def lost(self, slot: Slot) -> None:
        """The slot's actor is gone; what it had brought stays good."""
        if not slot.awaited:
            self._comparison.lost(slot.number)

    def share_out(self) -> None:
        """Hand the work of slots without an actor to those that have one.

        A slot counts as manned while its first actor has yet to come and is waited for, and while an actor is in it,
        unless that is a late or a returning one that still compiles: it is used from when it is ready.
        """
        manned = [slot for slot in self._slots if slot.manned]
        able = [slot.number for slot in manned if slot.member is not None]
        delivered = self.brought
        orphaned = [slot.number for slot in self._slots if slot not in manned and slot.number not in delivered]
        self._extra.clear()
        for turn, _ in enumerate(orphaned):
            if able:
                self._extra[able[turn % len(able)]] += 1

    @property
    def missing(self) -> int:
        """Rollouts that the next update still lacks; 0 while none are collected."""
        return len(self._slots) - len(self._taken) if self._collecting else 0

    @property
    def brought(self) -> set[int]:
        """Slots with a rollout for the next update."""
        return {number for number, _, _ in self._taken}

    @property
    def there(self) -> int:
        """Rollouts in the log for the next update."""
        return len(self._taken)

    def _settle(self, rollouts: Collection[Rollout]) -> None:
        self._taken |= {rollout.place: rollout for rollout in rollouts}
        self._settled = {rollout.slot for rollout in rollouts}
