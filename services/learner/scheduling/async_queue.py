"""The queue of async mode: actors work on while the learner updates, and an update takes the oldest rollouts.

Every update uses K rollouts, in the order in which they came into the log, whichever slots they are from. With a
staleness bound S at most (S + 1) K are there or asked for, those of the current update among them. So a rollout begun
under version v is used by update v + S + 1 at the latest, if it is not overtaken by those of faster actors; one that is
would be older than S when its turn comes: it is refused as it arrives, and once more before it would be used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from typing import final

from common.wire.messages import PushReply
from common.wire.rollout import Rollout
from services.learner.scheduling.buffer import RolloutBuffer
from services.learner.scheduling.slots import Refusal, Slot


@final
class AsyncQueue(RolloutBuffer):
    """The rollouts that are waiting for their update.

    Args:
        max_staleness: S, versions that a rollout may lie behind the policy that it updates.
        updates: of the whole run; beyond them nothing is collected.
    """

    def __init__(self, slots: Sequence[Slot], max_staleness: int, updates: int) -> None:
        super().__init__(slots)
        self._max_staleness = max_staleness
        self._updates = updates
        self._waiting: list[Rollout] = []
        self._used = 0
        self._made: Counter[str] = Counter()
        self._quota: Counter[int] = Counter()

    @property
    def divergence(self) -> str | None:
        """None: what actors make in this mode depends on the timing, so nothing is made again and compared."""
        return None

    @property
    def reserves_slots(self) -> bool:
        return False

    def begin(
        self, version: int, *, collect: bool, logged: Collection[Rollout] = (), settled: Collection[Rollout] = ()
    ) -> list[Rollout]:
        """As `Fleet.begin`; the rollouts of the last `take` have been used. `settled` join the queue in their order."""
        assert not logged, "rollouts are not made again in async mode"
        self._version = version
        self._collecting = collect
        del self._waiting[: self._used]
        self._used = 0
        self._waiting += settled
        self._made.clear()
        overtaken = [rollout for rollout in self._waiting if self._too_old(rollout, version)]
        self._waiting = [rollout for rollout in self._waiting if not self._too_old(rollout, version)]
        return overtaken

    def start_over(self, settled: Collection[Rollout], *, collect: bool) -> None:
        self._collecting = collect
        self._waiting += settled

    def refusal(self, rollout: Rollout) -> Refusal | None:
        if not self._collecting or self._outstanding >= self._capacity:
            return self._enough()
        update = self._version + self._outstanding // len(self._slots)
        if rollout.policy_version > self._version or self._too_old(rollout, update):
            return Refusal(
                "stale",
                f"made with policy {rollout.policy_version}; the update of policy {update} that would use it takes "
                f"none older than {max(update - self._max_staleness, 0)}",
            )
        return None

    def admit(self, rollout: Rollout) -> PushReply | None:
        self.pending[rollout.key] = rollout.id
        if rollout.policy_version == self._version:
            self._made[rollout.incarnation] += 1
        return None

    def accept(self, rollout: Rollout) -> None:
        del self.pending[rollout.key]
        self._waiting.append(rollout)

    def take(self) -> list[Rollout] | None:
        count = len(self._slots)
        if len(self._waiting) < count:
            return None
        self._used = count
        return sorted(self._waiting[:count], key=lambda rollout: rollout.id)

    def wanted(self, slot: int) -> int:
        member = self._slots[slot].member
        if member is None or not self._collecting:
            return 0
        return self._made[member.incarnation] + max(0, self._quota[slot] - self._outstanding_of(slot))

    def actor_lost(self, slot: Slot) -> None:
        """Nothing changes in the queue."""

    def assign_work(self) -> None:
        ready = [slot.number for slot in self._slots if slot.member is not None and slot.member.ready]
        self._quota.clear()
        for turn in range(self._capacity if ready else 0):
            self._quota[ready[turn % len(ready)]] += 1

    @property
    def missing(self) -> int:
        return max(0, len(self._slots) - len(self._waiting)) if self._collecting else 0

    @property
    def delivered(self) -> set[int]:
        return {rollout.slot for rollout in self._waiting}

    @property
    def available(self) -> int:
        return min(len(self._waiting), len(self._slots))

    def _too_old(self, rollout: Rollout, version: int) -> bool:
        return version - rollout.policy_version > self._max_staleness

    def _outstanding_of(self, slot: int) -> int:
        waiting = sum(rollout.slot == slot for rollout in self._waiting)
        return waiting + sum(identity.slot == slot for identity in self.pending.values())

    @property
    def _outstanding(self) -> int:
        return len(self._waiting) + len(self.pending)

    @property
    def _capacity(self) -> int:
        """Rollouts that may be there or asked for: no more than the rest of the run needs."""
        return min(self._max_staleness + 1, self._updates - self._version) * len(self._slots)
