"""The fleet, whatever happens in whatever order."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from samples import RUN, heartbeat, rollout

from common.errors import RefusedError
from common.wire.messages import Orders
from common.wire.rollout import Rollout
from services.learner.scheduling.fleet import Fleet

BLANK = rollout()
STATES = ("compiling", "waiting", "collecting", "pushing", "evaluating")


def numbered(slot: int, incarnation: str, seq: int, version: int, generation: int) -> Rollout:
    return dataclasses.replace(
        BLANK, slot=slot, incarnation=incarnation, seq=seq, policy_version=version, generation=generation
    )


def orders(fleet: Fleet) -> Orders:
    return fleet.orders(digest="d", size=7, t_ns=3)


class AnyOrderOfThings(RuleBasedStateMachine):
    """Actors come and go, heartbeats and rollouts come in any order, twice or never, and versions begin at any time.

    Promised whatever the sequence: a batch that is given out has exactly one rollout for each slot, all of the
    current version, none of which was ever used before; and a version's batch is completed once every actor that is
    left does what it is asked, unless it waits for a slot that nobody has held and that is not excused.
    """

    @initialize(slots=st.integers(1, 4))
    def start(self, slots: int) -> None:
        self.slots = slots
        self.fleet = Fleet(RUN, slots)
        self.fleet.begin(0)
        self.version = 0
        self.let_in = 0
        self.delivered: set[int] = set()
        self.excused: set[int] = set()
        self.given = [0] * slots
        self.present: dict[str, int] = {}
        self.gone: list[tuple[str, int]] = []
        self.admitted: dict[str, int] = {}
        self.generation: dict[str, int] = {}
        self.made: dict[str, int] = {}
        self.under_way: list[Rollout] = []
        self.used: set[tuple[int, str, int]] = set()

    @rule()
    def join(self) -> None:
        name = f"i{sum(self.given)}"
        free = [slot for slot in range(self.slots) if slot not in self.present.values()]
        if not free:
            with pytest.raises(RefusedError, match="slots are taken"):
                self.fleet.join(name, "native", 0.0)
            return
        slot = self.fleet.join(name, "native", 0.0)
        assert slot.number == free[0]
        assert slot.member is not None
        assert slot.member.generation == self.given[slot.number]
        self.generation[name] = self.given[slot.number]
        self.given[slot.number] += 1
        self.present[name] = slot.number
        self.admitted[name] = self.made[name] = 0

    @precondition(lambda self: self.present)
    @rule(data=st.data())
    def join_again(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(sorted(self.present)))
        assert self.fleet.join(name, "native", 0.0).number == self.present[name]

    @precondition(lambda self: self.gone)
    @rule(data=st.data())
    def come_back_under_an_old_name(self, data: st.DataObject) -> None:
        name, _ = data.draw(st.sampled_from(self.gone))
        with pytest.raises(RefusedError, match="has lost its slot"):
            self.fleet.join(name, "native", 0.0)

    @precondition(lambda self: self.present)
    @rule(data=st.data())
    def lose(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(sorted(self.present)))
        slot = self.fleet.remove(name)
        assert slot is not None
        assert slot.number == self.present[name]
        self.gone.append((name, self.present.pop(name)))

    @precondition(lambda self: self.present or self.gone)
    @rule(data=st.data(), state=st.sampled_from(STATES))
    def heartbeat(self, data: st.DataObject, state: str) -> None:
        name, slot = data.draw(st.sampled_from([*sorted(self.present.items()), *self.gone]))
        changed = self.fleet.record_heartbeat(heartbeat(slot, name, state), 0.0)
        assert name in self.present or not changed

    @precondition(lambda self: self.present)
    @rule(data=st.data(), logged=st.booleans())
    def push_what_is_next(self, data: st.DataObject, logged: bool) -> None:
        name = data.draw(st.sampled_from(sorted(self.present)))
        self.push(name, self.present[name], self.admitted[name], self.version, logged)

    @precondition(lambda self: self.present or self.gone)
    @rule(data=st.data(), seq_off=st.integers(-1, 1), version_off=st.integers(-1, 1), logged=st.booleans())
    def push_anything(self, data: st.DataObject, seq_off: int, version_off: int, logged: bool) -> None:
        name, slot = data.draw(st.sampled_from([*sorted(self.present.items()), *self.gone]))
        self.push(name, slot, max(0, self.admitted[name] + seq_off), max(0, self.version + version_off), logged)

    def push(self, name: str, slot: int, seq: int, version: int, logged: bool) -> None:
        made = numbered(slot, name, seq, version, self.generation[name])
        known = seq < self.admitted[name]
        waiting = [other.key for other in self.under_way]
        answer = self.fleet.admit(made)
        if answer is None:
            assert name in self.present
            assert (seq, version) == (self.admitted[name], self.version)
            self.note_admitted(name, made)
            if logged:
                self.log(made)
        elif answer.status == "accepted":
            assert known
            assert made.key not in waiting
        elif answer.status == "busy":
            assert made.key in waiting
        else:
            assert name in self.gone_names or not known

    @precondition(lambda self: self.under_way)
    @rule(data=st.data())
    def reach_the_log(self, data: st.DataObject) -> None:
        self.log(self.under_way[data.draw(st.integers(0, len(self.under_way) - 1))])

    @rule()
    def update_or_wait(self) -> None:
        if self.use_batch():
            self.begin()

    @rule()
    def excuse_who_never_came(self) -> None:
        self.excused |= set(self.fleet.release_reserved())
        assert all(count or slot in self.excused for slot, count in enumerate(self.given))

    @rule()
    def begin_early(self) -> None:
        self.begin()

    @precondition(lambda self: self.present and all(n or slot in self.excused for slot, n in enumerate(self.given)))
    @rule()
    def everyone_left_does_what_is_asked(self) -> None:
        for made in list(self.under_way):
            self.log(made)
        for name, slot in self.present.items():
            self.fleet.record_heartbeat(heartbeat(slot, name, "waiting"), 0.0)
        collect = orders(self.fleet).collect
        assert set(collect) == set(self.present.values())
        for name, slot in self.present.items():
            while self.made[name] < collect[slot]:
                made = numbered(slot, name, self.admitted[name], self.version, self.generation[name])
                answer = self.fleet.admit(made)
                if answer is not None:
                    assert answer.slug == "surplus"
                    break
                self.note_admitted(name, made)
                self.log(made)
        assert self.use_batch()
        self.begin()

    @invariant()
    def orders_name_those_who_are_here(self) -> None:
        said = orders(self.fleet)
        assert said.version == self.version
        assert set(said.collect) == set(self.present.values())
        # A slot is asked for nothing only where its incarnations have delivered what it owes.
        delivered = {made.slot for made in self.under_way} | self.delivered
        assert all(count >= 1 or slot in delivered for slot, count in said.collect.items())

    @property
    def gone_names(self) -> set[str]:
        return {name for name, _ in self.gone}

    def note_admitted(self, name: str, made: Rollout) -> None:
        self.admitted[name] += 1
        self.made[name] += 1
        # No more are let into the log than the version's batch holds.
        self.let_in += 1
        assert self.let_in <= self.slots
        self.under_way.append(made)

    def log(self, made: Rollout) -> None:
        self.fleet.accept(made)
        self.delivered |= {made.slot} if made.policy_version == self.version else set()
        self.under_way = [other for other in self.under_way if other is not made]

    def begin(self) -> None:
        self.version += 1
        self.fleet.begin(self.version)
        self.let_in = 0
        self.delivered = set()
        self.made = dict.fromkeys(self.made, 0)

    def use_batch(self) -> bool:
        taken = self.fleet.take()
        if taken is None:
            return False
        keys = {r.key for r in taken}
        assert len(taken) == len(keys) == self.slots
        assert {r.policy_version for r in taken} == {self.version}
        assert [r.slot for r in taken] == sorted(r.slot for r in taken)
        assert not keys & self.used
        self.used |= keys
        return True


TestAnyOrderOfThings = AnyOrderOfThings.TestCase
TestAnyOrderOfThings.settings = hypothesis_settings(max_examples=80, stateful_step_count=50)
