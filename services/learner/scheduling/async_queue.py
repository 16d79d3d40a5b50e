"""The queue of async mode: actors work on while the learner updates, and an update takes the oldest rollouts.

Of every update K rollouts are used, in the order in which they came into the log, whichever slots they are from. With a
staleness bound S at most (S + 1) K are there or asked for, those of the update in work among them. So a rollout
begun under version v is used by update v + S + 1 at the latest, if it is not overtaken by those of faster actors; one
that is would be older than S when its turn comes: it is refused as it arrives, and once more before it would be used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from common.wire.messages import PushReply, Rollout
from services.learner.scheduling.slots import Objection, Place, RolloutKey, Slot


class AsyncQueue:
    """The rollouts that are waiting for their update. `slots` is the fleet's own list.

    Args:
        max_staleness: S, versions that a rollout may lie behind the policy that it updates.
        updates: of the whole run; beyond them nothing is collected.
    """

    def __init__(self, slots: Sequence[Slot], max_staleness: int, updates: int) -> None:
        self._slots = slots
        self._max_staleness = max_staleness
        self._updates = updates
        self._version = 0
        self._collecting = True
        self._waiting: list[Rollout] = []
        self._used = 0
        self._made: Counter[str] = Counter()
        self._quota: Counter[int] = Counter()
        self.under_way: dict[RolloutKey, Place] = {}

    @property
    def divergence(self) -> str | None:
        """None: what actors make in this mode depends on the timing, so nothing is made again."""
        return None

    @property
    def waits(self) -> bool:
        """Nobody is waited for."""
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
        """As `Fleet.start_over`."""
        self._collecting = collect
        self._waiting += settled

    def objection(self, rollout: Rollout) -> Objection | None:
        """Why a rollout of the slot's own actor is of no use."""
        if not self._collecting or self._outstanding >= self._capacity:
            return "surplus", f"policy {self._version} has all the rollouts it needs"
        update = self._version + self._outstanding // len(self._slots)
        if rollout.policy_version > self._version or self._too_old(rollout, update):
            return (
                "stale",
                f"made with policy {rollout.policy_version}; the update of policy {update} that would use it takes "
                f"none older than {max(update - self._max_staleness, 0)}",
            )
        return None

    def admit(self, rollout: Rollout) -> PushReply | None:
        """None: it is to be logged, and is under way until then."""
        self.under_way[rollout.key] = rollout.place
        if rollout.policy_version == self._version:
            self._made[rollout.incarnation] += 1
        return None

    def accept(self, rollout: Rollout) -> None:
        """It is in the log: it counts. The log has them in the order of these calls."""
        del self.under_way[rollout.key]
        self._waiting.append(rollout)

    def take(self) -> list[Rollout] | None:
        """The oldest K rollouts in (slot, generation, seq) order, the same until `begin`; None while there are less."""
        count = len(self._slots)
        if len(self._waiting) < count:
            return None
        self._used = count
        return sorted(self._waiting[:count], key=lambda rollout: rollout.place)

    def wanted(self, slot: int) -> int:
        """Rollouts that the slot's actor is to make in all under this version."""
        member = self._slots[slot].member
        if member is None or not self._collecting:
            return 0
        mine = sum(rollout.slot == slot for rollout in self._waiting)
        mine += sum(number == slot for number, _, _ in self.under_way.values())
        return self._made[member.incarnation] + max(0, self._quota[slot] - mine)

    def lost(self, slot: Slot) -> None:
        """The slot's actor is gone; what it had brought stays good."""

    def share_out(self) -> None:
        """Divide what may be there or asked for among the actors that are ready."""
        ready = [slot.number for slot in self._slots if slot.member is not None and slot.member.ready]
        self._quota.clear()
        for turn in range(self._capacity if ready else 0):
            self._quota[ready[turn % len(ready)]] += 1

    @property
    def missing(self) -> int:
        """Rollouts that the next update still lacks; 0 while none are collected."""
        return max(0, len(self._slots) - len(self._waiting)) if self._collecting else 0

    @property
    def brought(self) -> set[int]:
        """Slots with a rollout in the queue."""
        return {rollout.slot for rollout in self._waiting}

    @property
    def there(self) -> int:
        """Rollouts in the log for the next update."""
        return min(len(self._waiting), len(self._slots))

    def _too_old(self, rollout: Rollout, version: int) -> bool:
        return version - rollout.policy_version > self._max_staleness

    @property
    def _outstanding(self) -> int:
        return len(self._waiting) + len(self.under_way)

    @property
    def _capacity(self) -> int:
        """Rollouts that may be there or asked for: no more than the rest of the run needs."""
        return min(self._max_staleness + 1, self._updates - self._version) * len(self._slots)
