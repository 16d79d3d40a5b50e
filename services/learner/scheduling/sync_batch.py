"""The batch of sync mode: one rollout of the current version from every slot, whatever the timing.

While a slot has no actor, another delivers its rollout. A slot that no actor has held yet is waited for, so that a
run's first batch, and with it the whole run, is the same whichever actor comes first; unless that wait is over.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from typing import final

from common.wire.messages import ACCEPTED, PushReply
from common.wire.rollout import Rollout, RolloutId
from services.learner.scheduling.buffer import RolloutBuffer
from services.learner.scheduling.comparison import Comparison
from services.learner.scheduling.slots import Refusal, Slot


@final
class SyncBatch(RolloutBuffer):
    """The rollouts of the version that is being collected."""

    def __init__(self, slots: Sequence[Slot]) -> None:
        super().__init__(slots)
        self._settled: set[RolloutId] = set()
        self._comparison = Comparison()
        self._taken: dict[RolloutId, Rollout] = {}
        self._extra: Counter[int] = Counter()

    @property
    def divergence(self) -> str | None:
        return self._comparison.divergence

    @property
    def reserves_slots(self) -> bool:
        return True

    def begin(
        self, version: int, *, collect: bool, logged: Collection[Rollout] = (), settled: Collection[Rollout] = ()
    ) -> list[Rollout]:
        self._version = version
        self._collecting = collect
        self._comparison.begin(logged)
        self._taken.clear()
        self._settle(settled)
        self._extra.clear()
        return []

    def start_over(self, settled: Collection[Rollout], *, collect: bool) -> None:
        self._collecting = collect
        self._comparison.begin(())
        self._settle(settled)

    def refusal(self, rollout: Rollout) -> Refusal | None:
        if rollout.policy_version != self._version or self.divergence is not None:
            return Refusal("stale", f"made with policy {rollout.policy_version}; policy {self._version} is wanted")
        if not self._collecting or len(self._taken) + len(self.pending) >= len(self._slots):
            return self._enough()
        # Without this an actor that ignores its orders would fill the batch, and no other slot would ever be used; nor
        # does it help to join again, since the rollouts of all incarnations of the slot count.
        if len(self._made(rollout.slot)) >= (quota := self._quota(rollout.slot)):
            return Refusal("surplus", f"policy {self._version} needs {quota} of slot {rollout.slot}, and has as many")
        return None

    def admit(self, rollout: Rollout) -> PushReply | None:
        if (logged := self._comparison.logged(rollout.id, rollout)) is not None:
            self._taken[rollout.id] = logged
            return ACCEPTED
        self.pending[rollout.key] = rollout.id
        return None

    def accept(self, rollout: Rollout) -> None:
        identity = self.pending.pop(rollout.key)
        if rollout.policy_version == self._version:
            self._taken[identity] = rollout

    def take(self) -> list[Rollout] | None:
        if len(self._taken) < len(self._slots):
            return None
        return [self._taken[identity] for identity in sorted(self._taken)]

    def wanted(self, slot: int) -> int:
        member = self._slots[slot].member
        if not self._collecting or member is None:
            return self._quota(slot) if self._collecting else 0
        # An actor counts what it has made itself, so what its predecessors made is taken off.
        others = sum(identity.generation != member.generation for identity in self._made(slot))
        return max(0, self._quota(slot) - others)

    def actor_lost(self, slot: Slot) -> None:
        if not slot.reserved:
            self._comparison.actor_lost(slot.number)

    def assign_work(self) -> None:
        covered = [slot for slot in self._slots if slot.covered]
        able = [slot.number for slot in covered if slot.member is not None]
        delivered = self.delivered
        orphaned = [slot.number for slot in self._slots if slot not in covered and slot.number not in delivered]
        self._extra.clear()
        for turn, _ in enumerate(orphaned):
            if able:
                self._extra[able[turn % len(able)]] += 1

    @property
    def missing(self) -> int:
        return len(self._slots) - len(self._taken) if self._collecting else 0

    @property
    def delivered(self) -> set[int]:
        return {identity.slot for identity in self._taken}

    @property
    def available(self) -> int:
        return len(self._taken)

    def _quota(self, slot: int) -> int:
        """Rollouts of this version that are needed of the slot, beside those that need not be made again."""
        own = 0 if any(identity.slot == slot for identity in self._settled) else 1
        return own + self._extra[slot]

    def _made(self, slot: int) -> list[RolloutId]:
        """Rollouts of this version of the slot, of whichever incarnation, that are in the batch or being logged."""
        there = (self._taken.keys() - self._settled) | set(self.pending.values())
        return [identity for identity in there if identity.slot == slot]

    def _settle(self, rollouts: Collection[Rollout]) -> None:
        self._taken |= {rollout.id: rollout for rollout in rollouts}
        self._settled = {rollout.id for rollout in rollouts}
