"""The actors of a run, the work asked of them, and the rollouts that count.

A slot is held by one incarnation (one life of an actor process) at a time. Which rollouts an update is made of depends
on the mode: `SyncBatch` or `AsyncQueue`.

There are no threads, clocks or sessions here: the service holds a lock around every call and passes the time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from common.errors import RefusedError
from common.printable import quoted, shortened
from common.wire.messages import ACCEPTED, Heartbeat, Orders, PushReply
from common.wire.rollout import Rollout
from services.learner.scheduling.buffer import RolloutBuffer
from services.learner.scheduling.slots import Counts, Departed, Member, Slot, Start
from services.learner.scheduling.sync_batch import SyncBatch
from services.learner.scheduling.waiting import describe_missing


class Fleet:
    """The slots of one run and the rollouts that the next updates are made of."""

    def __init__(
        self,
        run: str,
        slots: int,
        starts: Sequence[Start] = (),
        make_buffer: Callable[[Sequence[Slot]], RolloutBuffer] = SyncBatch,
    ) -> None:
        """`starts` by slot, where a run is resumed."""
        self._run = run
        self._slots = [Slot(number) for number in range(slots)]
        self._set_starts(starts)
        self._buffer = make_buffer(self._slots)
        self._version = 0
        self._hand_in = False
        self._departed = Departed()
        self._evaluator: int | None = None
        self._episodes = 0
        self._finished = False
        self.counts = Counts()

    # -- joining and leaving -------------------------------------------------------------------------------

    def join(self, incarnation: str, physics: str, now_s: float) -> Slot:
        """Assign the lowest free slot. RefusedError where none is free, or this incarnation has lost its slot."""
        if incarnation in self._departed:
            # Its rollouts would be taken for duplicates of those from its first time in the slot.
            raise RefusedError(f"{_shown(incarnation)} has lost its slot; join as another incarnation")
        for slot in self._slots:
            if slot.member is not None and slot.member.incarnation == incarnation:
                return slot
        for slot in self._slots:
            if slot.member is None:
                start = slot.start or Start(slot.given)
                slot.member = Member(incarnation, start.generation, physics, heard_s=now_s, next_seq=start.seq)
                slot.given = start.generation + 1
                self.counts.joined += 1
                self._assign_work()
                return slot
        raise RefusedError(
            f"all {len(self._slots)} slots are taken; this actor stands by and takes over when one is freed"
        )

    def release_reserved(self) -> list[int]:
        """End the wait for slots that no actor has held yet: their work goes to the actors that are here.

        Returns the slots that were reserved until now.
        """
        if not self._buffer.reserves_slots:
            return []
        released = [slot for slot in self._slots if slot.reserved and slot.member is None]
        for slot in released:
            slot.released = True
        if released:
            self._assign_work()
        return [slot.number for slot in released]

    def remove(self, incarnation: str) -> Slot | None:
        """Free the slot of an actor that is gone; None where it held none. Its accepted rollouts stay good."""
        for slot in self._slots:
            if slot.member is not None and slot.member.incarnation == incarnation:
                slot.member = None
                self._departed.add(incarnation)
                self.counts.lost += 1
                self._buffer.actor_lost(slot)
                if self._evaluator == slot.number:
                    self._evaluator = None
                self._assign_work()
                return slot
        return None

    def record_heartbeat(self, beat: Heartbeat, now_s: float) -> bool:
        """Record a heartbeat; returns whether orders change by it. One of an incarnation without a slot is ignored."""
        member = self.holder(beat.slot, beat.incarnation)
        if member is None:
            return False
        was_ready = member.ready
        member.state, member.state_s, member.heard_s = beat.state, beat.state_s, now_s
        member.version, member.env_steps, member.steps_per_s = beat.version, beat.env_steps, beat.steps_per_s
        if member.ready == was_ready:
            return False
        self._assign_work()
        return True

    def holder(self, slot: int, incarnation: str) -> Member | None:
        """The member of that slot, where it is this incarnation."""
        member = self._slots[slot].member if slot < len(self._slots) else None
        return member if member is not None and member.incarnation == incarnation else None

    def holds(self, slot: int, incarnation: str) -> bool:
        """True if this incarnation has that slot now."""
        return self.holder(slot, incarnation) is not None

    def silent(self, now_s: float, limit_s: float) -> list[str]:
        """Incarnations without a heartbeat for longer than the limit."""
        return [
            slot.member.incarnation
            for slot in self._slots
            if slot.member is not None and now_s - slot.member.heard_s > limit_s
        ]

    # -- the rollouts of a version -------------------------------------------------------------------------

    def begin(
        self,
        version: int,
        *,
        collect: bool = True,
        hand_in: bool = False,
        logged: Collection[Rollout] = (),
        settled: Collection[Rollout] = (),
    ) -> list[Rollout]:
        """Collect for this version from now on, or nothing any more (the last version of a run).

        Args:
            hand_in: ask for the environments' states as well.
            logged: rollouts of this version that are in the log of a resumed run: made again they are compared with
                it and not logged twice, and the batch takes those of the log.
            settled: rollouts in the log that are not to be made again. In sync mode their slots have nothing to do.

        Returns:
            Accepted rollouts that are too old to be used any more.
        """
        self._version = version
        self._hand_in = hand_in
        overtaken = self._buffer.begin(version, collect=collect, logged=logged, settled=settled)
        self._assign_work()
        return overtaken

    def admit(self, rollout: Rollout) -> PushReply | None:
        """None where a rollout is to be logged and used, else the answer for its sender.

        An admitted rollout is pending until `accept` is called with it.
        """
        member = self.holder(rollout.slot, rollout.incarnation)
        if rollout.run != self._run:
            return self._refuse("run", f"this learner runs {self._run!r}, not {quoted(rollout.run)}")
        if member is None:
            return self._refuse(
                "incarnation", f"slot {rollout.slot} is not held by {_shown(rollout.incarnation)}; join again"
            )
        if rollout.generation != member.generation:
            return self._refuse(
                "generation",
                f"{_shown(rollout.incarnation)} has generation {member.generation}, not {rollout.generation}",
            )
        if rollout.key in self._buffer.pending:
            return PushReply.busy("being_logged", "this rollout is being written to the log")
        if rollout.seq < member.next_seq:
            self.counts.repeated += 1
            return ACCEPTED
        if (refusal := self._buffer.refusal(rollout)) is not None:
            return self._refuse(*refusal)
        if rollout.seq > member.next_seq:
            return self._refuse("gap", f"rollout {rollout.seq} came where {member.next_seq} is next")
        member.next_seq = rollout.seq + 1
        self._slots[rollout.slot].start = None
        return self._buffer.admit(rollout)

    def accept(self, rollout: Rollout) -> None:
        """Count an admitted rollout that is in the log now."""
        self._buffer.accept(rollout)

    def take(self) -> list[Rollout] | None:
        """The rollouts of the next update in (slot, generation, seq) order, once they are there; else None."""
        return self._buffer.take()

    # -- resuming ------------------------------------------------------------------------------------------

    @property
    def divergence(self) -> str | None:
        """The first difference between what is made again and what the log holds; None without any."""
        return self._buffer.divergence

    def start_over(self, starts: Sequence[Start], settled: Collection[Rollout], *, collect: bool) -> None:
        """Free every slot, to go on at `starts`; the rest as `begin`. What was accepted stays good."""
        for slot in self._slots:
            if slot.member is not None:
                self._departed.add(slot.member.incarnation)
                slot.member = None
        self._set_starts(starts)
        self._buffer.start_over(settled, collect=collect)
        self._assign_work()

    def starts_from(self, slot: int) -> bytes | None:
        """The environments that a slot goes on from, as `Environment`; None for new ones."""
        start = self._slots[slot].start
        return None if start is None else start.environment

    def given(self) -> list[int]:
        """The number of times each slot was assigned, by slot."""
        return [slot.given for slot in self._slots]

    # -- orders --------------------------------------------------------------------------------------------

    def evaluate(self, episodes: int) -> None:
        """From now on ask for an evaluation instead of rollouts."""
        self._episodes = episodes
        self._assign_work()

    def finish(self) -> None:
        """From now on order that the run is over."""
        self._finished = True

    def orders(self, *, digest: str, size: int, t_ns: int) -> Orders:
        """The orders of this moment. `collect` counts from the version's start and has every slot that is held."""
        collect = {
            slot.number: self._buffer.wanted(slot.number)
            for slot in self._slots
            if slot.member is not None and not self._finished
        }
        evaluator = {} if self._evaluator is None or self._finished else {self._evaluator: self._episodes}
        return Orders(self._run, self._version, digest, size, collect, evaluator, self._finished, t_ns, self._hand_in)

    def waiting_for(self, now_s: float) -> str:
        """A sentence such as "waiting for 1 of 2 rollouts: slot 1 compiling 12 s"; empty where nothing is missing."""
        missing, delivered = self._buffer.missing, self._buffer.delivered
        if not missing:
            return ""
        written = {number for number, _, _ in self._buffer.pending.values()} - delivered
        who = describe_missing(self._slots, delivered, written, now_s)
        return f"waiting for {missing} of {len(self._slots)} rollouts: {who}"

    def members(self) -> list[tuple[int, Member]]:
        return [(slot.number, slot.member) for slot in self._slots if slot.member is not None]

    def was_held(self, slot: int) -> bool:
        """True if the slot has ever been assigned."""
        return self._slots[slot].given > 0

    @property
    def available(self) -> int:
        """Rollouts for the next update that are in the log."""
        return self._buffer.available

    @property
    def episodes(self) -> int:
        """Episodes of the evaluation that is wanted; 0 while none is."""
        return self._episodes

    @property
    def version(self) -> int:
        return self._version

    @property
    def hand_in(self) -> bool:
        """True if the states of environments are wanted with this version."""
        return self._hand_in and self.divergence is None

    @property
    def finished(self) -> bool:
        return self._finished

    # -- inside --------------------------------------------------------------------------------------------

    def _set_starts(self, starts: Sequence[Start]) -> None:
        for slot, start in zip(self._slots, starts, strict=False):
            slot.given, slot.start = start.generation, start

    def _refuse(self, slug: str, text: str) -> PushReply:
        self.counts.refused[slug] += 1
        return PushReply.refused(slug, text)

    def _assign_work(self) -> None:
        """Divide the work anew: after every change of who is here."""
        if self._episodes and self._evaluator is None:
            ready = [slot.number for slot in self._slots if slot.member is not None and slot.member.ready]
            self._evaluator = ready[0] if ready else None
        self._buffer.assign_work()


def _shown(incarnation: str) -> str:
    return quoted(shortened(incarnation))
