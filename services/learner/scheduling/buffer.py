"""The contract of what an update's rollouts are collected in: a batch in sync mode, a queue in async mode."""

from __future__ import annotations

import abc
from collections.abc import Collection, Sequence

from common.wire.messages import PushReply
from common.wire.rollout import Rollout, RolloutId, RolloutKey
from services.learner.scheduling.slots import Refusal, Slot


class RolloutBuffer(abc.ABC):
    """The rollouts for the next updates. `slots` is the fleet's own list.

    Implementations: `SyncBatch`, `AsyncQueue`.
    """

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._slots = slots
        self._version = 0
        self._collecting = True
        self.pending: dict[RolloutKey, RolloutId] = {}
        """Admitted rollouts that are being written to the log."""

    @property
    @abc.abstractmethod
    def divergence(self) -> str | None:
        """The first difference between what actors of a resumed run make and what its log holds; None without any."""

    @property
    @abc.abstractmethod
    def reserves_slots(self) -> bool:
        """True if a slot that no actor has held yet is waited for."""

    @abc.abstractmethod
    def begin(
        self, version: int, *, collect: bool, logged: Collection[Rollout] = (), settled: Collection[Rollout] = ()
    ) -> list[Rollout]:
        """As `Fleet.begin`."""

    @abc.abstractmethod
    def start_over(self, settled: Collection[Rollout], *, collect: bool) -> None:
        """As `Fleet.start_over`."""

    @abc.abstractmethod
    def refusal(self, rollout: Rollout) -> Refusal | None:
        """The reason why a rollout of the slot's own actor is of no use; None where it is."""

    @abc.abstractmethod
    def admit(self, rollout: Rollout) -> PushReply | None:
        """None where the rollout is to be logged, and is pending until then; `ACCEPTED` where the log has it."""

    @abc.abstractmethod
    def accept(self, rollout: Rollout) -> None:
        """Count a pending rollout that is in the log now. The log has them in the order of these calls."""

    @abc.abstractmethod
    def take(self) -> list[Rollout] | None:
        """The rollouts of the next update in (slot, generation, seq) order, the same until `begin`; None before."""

    @abc.abstractmethod
    def wanted(self, slot: int) -> int:
        """The number of rollouts that the slot's actor is to make in all under this version."""

    @abc.abstractmethod
    def actor_lost(self, slot: Slot) -> None:
        """Note that the slot's actor is gone; what it had delivered stays good."""

    @abc.abstractmethod
    def assign_work(self) -> None:
        """Divide the work among the actors that are here. To be called after every change of who is."""

    @property
    @abc.abstractmethod
    def missing(self) -> int:
        """Rollouts that the next update still lacks; 0 while none are collected."""

    @property
    @abc.abstractmethod
    def delivered(self) -> set[int]:
        """Slots with a rollout in the log for the next updates."""

    @property
    @abc.abstractmethod
    def available(self) -> int:
        """Rollouts in the log for the next update."""

    def _enough(self) -> Refusal:
        return Refusal("surplus", f"policy {self._version} has all the rollouts it needs")
