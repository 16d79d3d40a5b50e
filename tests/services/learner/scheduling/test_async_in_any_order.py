"""The queue of async mode, whatever happens in whatever order."""

from __future__ import annotations

import dataclasses
from functools import partial

from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from samples import RUN, heartbeat, rollout

from common.wire.rollout import Rollout
from services.learner.scheduling.async_queue import AsyncQueue
from services.learner.scheduling.fleet import Fleet

BLANK = rollout()
UPDATES = 1000


class AnyOrderOfThings(RuleBasedStateMachine):
    """Actors come, work at any speed and go; updates are made whenever there is enough for one.

    Promised whatever the sequence: an update has as many rollouts as there are slots, each accepted once, used once
    and no older than the bound; no more are accepted than the bound allows; and the next update is complete once
    every actor that is ready does what it is asked.
    """

    @initialize(slots=st.integers(1, 3), max_staleness=st.integers(0, 3))
    def start(self, slots: int, max_staleness: int) -> None:
        self.slots, self.max_staleness = slots, max_staleness
        self.fleet = Fleet(RUN, slots, make_buffer=partial(AsyncQueue, max_staleness=max_staleness, updates=UPDATES))
        self.version = 0
        self.fleet.begin(0)
        self.names = 0
        self.present: dict[str, tuple[int, int]] = {}
        self.ready: set[str] = set()
        self.admitted: dict[str, int] = {}
        self.policy: dict[str, int] = {}
        self.made: dict[str, int] = {}
        self.under_way: list[Rollout] = []
        self.logged: list[Rollout] = []
        self.used: set[tuple[int, str, int]] = set()

    @precondition(lambda self: len(self.present) < self.slots)
    @rule()
    def join(self) -> None:
        name, self.names = f"i{self.names}", self.names + 1
        slot = self.fleet.join(name, "native", 0.0)
        assert slot.member is not None
        self.present[name] = (slot.number, slot.member.generation)
        self.admitted[name] = self.policy[name] = self.made[name] = 0

    @precondition(lambda self: self.present)
    @rule(data=st.data(), ready=st.booleans())
    def heartbeat(self, data: st.DataObject, ready: bool) -> None:
        name = data.draw(st.sampled_from(sorted(self.present)))
        self.hear(name, ready)

    def hear(self, name: str, ready: bool) -> None:
        self.fleet.record_heartbeat(heartbeat(self.present[name][0], name, "waiting" if ready else "compiling"), 0.0)
        (self.ready.add if ready else self.ready.discard)(name)

    @precondition(lambda self: self.present)
    @rule(data=st.data())
    def lose(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(sorted(self.present)))
        assert self.fleet.remove(name) is not None
        del self.present[name]
        self.ready.discard(name)

    @precondition(lambda self: self.present)
    @rule(data=st.data(), newest=st.booleans(), log=st.booleans())
    def push(self, data: st.DataObject, newest: bool, log: bool) -> None:
        """A rollout by the policy that the actor has, or by the newest, asked for or not."""
        name = data.draw(st.sampled_from(sorted(self.present)))
        self.bring(name, newest=newest, log=log)

    def bring(self, name: str, *, newest: bool, log: bool) -> bool:
        if newest and self.policy[name] != self.version:
            self.policy[name], self.made[name] = self.version, 0
        slot, generation = self.present[name]
        made = dataclasses.replace(
            BLANK,
            slot=slot,
            incarnation=name,
            seq=self.admitted[name],
            policy_version=self.policy[name],
            generation=generation,
        )
        answer = self.fleet.admit(made)
        if answer is not None:
            assert answer.slug in ("stale", "surplus")
            return False
        self.admitted[name] += 1
        self.made[name] += 1
        self.under_way.append(made)
        if log:
            self.log(made)
        return True

    @precondition(lambda self: self.under_way)
    @rule(data=st.data())
    def reach_the_log(self, data: st.DataObject) -> None:
        """In any order: threads may pass each other between being admitted and the log."""
        self.log(self.under_way[data.draw(st.integers(0, len(self.under_way) - 1))])

    def log(self, made: Rollout) -> None:
        self.under_way.remove(made)
        self.fleet.accept(made)
        self.logged.append(made)

    @rule()
    def update_or_wait(self) -> None:
        self.use_batch()

    def use_batch(self) -> bool:
        batch = self.fleet.take()
        if batch is None:
            return False
        assert [made.id for made in batch] == sorted(made.id for made in batch)
        assert {made.key for made in batch} == {made.key for made in self.logged[: self.slots]}
        assert len(batch) == self.slots
        assert all(0 <= self.version - made.policy_version <= self.max_staleness for made in batch)
        assert not self.used & {made.key for made in batch}
        self.used |= {made.key for made in batch}
        del self.logged[: self.slots]
        self.version += 1
        for overtaken in self.fleet.begin(self.version):
            assert self.version - overtaken.policy_version > self.max_staleness
            self.logged.remove(overtaken)
        return True

    @precondition(lambda self: self.present)
    @rule()
    def everyone_does_what_is_asked(self) -> None:
        for made in list(self.under_way):
            self.log(made)
        for name in self.present:
            self.hear(name, ready=True)
        for name, (slot, _) in self.present.items():
            wanted = self.fleet.orders(digest="d", size=7, t_ns=3).collect[slot]
            done = self.made[name] if self.policy[name] == self.version else 0
            for _ in range(wanted - done):
                if not self.bring(name, newest=True, log=True):
                    break
        assert self.use_batch()

    @invariant()
    def no_more_than_the_bound_allows(self) -> None:
        assert len(self.logged) + len(self.under_way) <= (self.max_staleness + 1) * self.slots
        said = self.fleet.orders(digest="d", size=7, t_ns=3)
        assert set(said.collect) == {slot for slot, _ in self.present.values()}


TestAnyOrderOfThings = AnyOrderOfThings.TestCase
TestAnyOrderOfThings.settings = hypothesis_settings(max_examples=60, stateful_step_count=30)
