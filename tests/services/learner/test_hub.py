"""The hub: the learner's answers, over real sessions on loopback and with a real log."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import pytest
from samples import RUN, evaluation, heartbeat, question, rollout, settings, snapshot

from common.errors import LogWriteError, SessionError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.settings_sources import parse_json
from common.wire import codec
from common.wire.keys import JOIN, Keys
from common.wire.messages import JoinReply, Orders, PushReply, Rollout, Snapshot
from common.wire.session import Session
from services.learner import hub as hub_module
from services.learner.hub import Hub, make_snapshot

DEADLINE_S = 15.0
KEYS = Keys(RUN)


class HeldLog:
    """A log that writes rollouts when it is told to, as a slow disk would."""

    def __init__(self, log: LogWriter) -> None:
        self._log = log
        self._held: Queue[tuple[bytes, Callable[[], None]]] = Queue()
        self._free = True

    def hold(self) -> None:
        self._free = False

    def let_one_go(self) -> None:
        """Write the rollout that has waited longest, once there is one."""
        data, on_durable = self._held.get(timeout=DEADLINE_S)
        self._log.write("/rollout", data, on_durable=on_durable)

    @property
    def pending_bytes(self) -> int:
        return self._log.pending_bytes

    @property
    def waiting(self) -> int:
        return self._held.qsize()

    def write(self, topic: str, data: Any, *, on_durable: Callable[[], None]) -> None:
        if self._free:
            self._log.write(topic, data, on_durable=on_durable)
        else:
            self._held.put((data, on_durable))


class Learner:
    """A hub at version 0 on a session of its own, and what it wrote and told."""

    def __init__(self, session: Session, directory: Path, **changes: Any) -> None:
        self.settings = settings(**changes)
        self.directory = directory
        self.writer = LogWriter(directory)
        self.log = HeldLog(self.writer)
        self.events: Queue[tuple[str, str, str]] = Queue()
        self.session = session
        log: Any = self.log
        self.hub = Hub(RUN, self.settings, session, log, lambda *event: self.events.put(event))
        self.hub.begin(snapshot(0))
        self.hub.open()

    def logged(self) -> list[bytes]:
        """The rollouts that are in the log's files now."""
        return [message.data for message in LogReader(self.directory).messages({"/rollout"})]


class Actor:
    """Asks as an actor does, in the words of the wire."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def ask(self, key: str, payload: bytes) -> bytes:
        return self.session.ask(key, payload, DEADLINE_S)

    def join(self, incarnation: str = "a", **changes: Any) -> JoinReply:
        return JoinReply.decode(self.ask(JOIN, question(incarnation, **changes).encode()))

    def push(self, made: Rollout) -> PushReply:
        return self.push_bytes(made.encode(), made.slot)

    def push_bytes(self, data: bytes, slot: int = 0) -> PushReply:
        return PushReply.decode(self.ask(KEYS.rollout(slot), data))


@pytest.fixture
def learners(sessions: Callable[..., Session], tmp_path: Path) -> Iterator[Callable[..., Learner]]:
    """Makes a learner: `learners(actors=1)`; its log is closed after its session."""
    with ExitStack() as stack:

        def make(**changes: Any) -> Learner:
            session = sessions(listen=True)
            learner = Learner(session, tmp_path / "log", **changes)
            stack.callback(learner.writer.close)
            stack.callback(session.close)
            return learner

        yield make


@pytest.fixture
def actors(sessions: Callable[..., Session], until: Callable[..., None]) -> Callable[[], Actor]:
    """Makes an actor that knows all of what the learner serves."""

    def make() -> Actor:
        actor = Actor(sessions())

        def reached() -> bool:
            # The hub serves joins last, and declarations arrive in order.
            try:
                return not actor.join("?", run="somewhere-else").accepted
            except SessionError:
                return False

        until(reached)
        return actor

    return make


# -- joining -----------------------------------------------------------------------------------------------


def test_joining_gives_slot_run_and_settings(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """All that an actor needs is in the answer; the learner's user is told who came."""
    learner, actor = learners(seed=5), actors()
    first, second = actor.join("a"), actor.join("b", run=RUN)
    assert (first.accepted, first.run, first.slot, first.generation) == (True, RUN, 0, 0)
    assert (second.accepted, second.run, second.slot, second.generation) == (True, RUN, 1, 0)
    assert parse_json(first.settings) == learner.settings
    assert learner.events.get(timeout=DEADLINE_S) == (
        "info",
        "actor_joined",
        "slot 0 (generation 0): native on here, incarnation a",
    )
    assert learner.hub.actors() == 2


def test_another_schema_is_refused_for_good(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """With a sentence that says what to do, in the learner's own schema."""
    learners()
    other = codec.encode(codec.decode(question().encode()) | {"schema": 999, "field_of_the_future": 1})
    reply = JoinReply.decode(actors().ask(JOIN, other))
    assert (reply.accepted, reply.final) == (False, True)
    assert reply.reason == (
        f"Join of schema 999, but this side speaks schema {codec.SCHEMA_VERSION}: "
        "run the same release on the learner and on the actors"
    )


def test_a_question_that_is_none_is_refused_for_good(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """The same bytes would be no better the next time."""
    learner = learners()
    reply = JoinReply.decode(actors().ask(JOIN, b"hello"))
    assert (reply.accepted, reply.final) == (False, True)
    assert "not a message" in reply.reason
    assert learner.hub.refusals() == {"not_msgpack": 1}


def test_another_run_is_refused_for_good(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """An actor that was told to work for one run works for no other."""
    learners()
    reply = actors().join(run="run-2")
    assert (reply.accepted, reply.final) == (False, True)
    assert reply.reason == "this learner runs 'run-1', not 'run-2'"


def test_a_full_run_is_refused_for_now(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """An actor more than there are slots stands by."""
    learners(actors=1, num_envs=2)
    actor = actors()
    actor.join("a")
    reply = actor.join("b")
    assert (reply.accepted, reply.final) == (False, False)
    assert reply.reason == "all 1 slots are taken; this actor stands by and takes over when one is freed"


def test_a_finished_run_is_refused_for_good(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """There is nothing to do any more."""
    learner, actor = learners(), actors()
    learner.hub.finish()
    reply = actor.join()
    assert (reply.accepted, reply.final) == (False, True)
    assert reply.reason == "run 'run-1' has finished"


@pytest.mark.parametrize(("asked", "found"), [("auto", {"mjx"}), ("native", {"native"})])
def test_engines_are_those_that_work(
    learners: Callable[..., Learner], actors: Callable[[], Actor], asked: str, found: set[str]
) -> None:
    """An actor's own engine counts only where the run leaves the choice to it."""
    learner = learners(physics=asked)
    actors().join(physics="mjx")
    assert learner.hub.engines() == found


# -- rollouts ----------------------------------------------------------------------------------------------


def test_a_rollout_is_accepted_once_it_is_in_the_log(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """At the moment of the answer the log's files hold the bytes that were sent, and nothing else."""
    learner, actor = learners(), actors()
    actor.join("a")
    made = rollout(0, "a")
    assert actor.push(made) == PushReply("accepted", "")
    assert learner.logged() == [made.encode()]


def test_a_rollout_that_is_not_in_the_log_is_neither_accepted_nor_used(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """While the disk is slow the answer waits, a repeat is told to wait, and the batch is not complete."""
    learner, actor = learners(actors=1, num_envs=2), actors()
    actor.join("a")
    learner.log.hold()
    made = rollout(0, "a")
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(actor.push, made)
        until(lambda: learner.log.waiting == 1)
        assert actor.push(made).status == "busy"
        assert learner.hub.rollouts(0.0) is None
        assert not answer.done()
        learner.log.let_one_go()
        assert answer.result(DEADLINE_S) == PushReply("accepted", "")
    assert actor.push(made).status == "accepted"
    taken = learner.hub.rollouts(0.0)
    assert taken is not None
    assert [r.key for r in taken] == [made.key]
    assert learner.logged() == [made.encode()]


def test_the_rollouts_of_a_version(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """Given out in the order of the slots as they were sent; the next version starts with none."""
    learner, actor = learners(), actors()
    actor.join("a")
    actor.join("b")
    sent = {slot: rollout(slot, name) for slot, name in ((1, "b"), (0, "a"))}
    for made in sent.values():
        assert actor.push(made).status == "accepted"
    taken = learner.hub.rollouts(DEADLINE_S)
    assert taken is not None
    assert [r.slot for r in taken] == [0, 1]
    for r in taken:
        np.testing.assert_array_equal(r.obs, sent[r.slot].obs)
    learner.hub.begin(snapshot(1))
    assert learner.hub.rollouts(0.0) is None
    assert learner.logged() == [sent[1].encode(), sent[0].encode()]


def test_waiting_for_rollouts_ends_when_the_last_is_there(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """The learner's loop wakes by itself."""
    learner, actor = learners(actors=1, num_envs=2), actors()
    actor.join("a")
    with ThreadPoolExecutor(1) as pool:
        taken = pool.submit(learner.hub.rollouts, DEADLINE_S)
        assert actor.push(rollout(0, "a")).status == "accepted"
        batch = taken.result(DEADLINE_S)
    assert batch is not None


def nan_reward() -> np.ndarray:
    reward = np.zeros((3, 2), np.float32)
    reward[1, 1] = np.nan
    return reward


MALFORMED: dict[str, tuple[Callable[[], bytes], str]] = {
    "no message at all": (lambda: b"\xc1 hello", "not_msgpack: "),
    "a message that is cut short": (lambda: rollout().encode()[:-1], "not_msgpack: "),
    "another message": (lambda: heartbeat().encode(), "missing_field: "),
    "another schema": (lambda: codec.encode(codec.decode(rollout().encode()) | {"schema": 0}), "schema: "),
    "a field too many": (lambda: codec.encode(codec.decode(rollout().encode()) | {"x": 1}), "unknown_field: "),
    "a dtype": (lambda: rollout(reward=np.zeros((3, 2), np.float64)).encode(), "bad_dtype: "),
    "other environments": (lambda: rollout(reward=np.zeros((3, 5), np.float32)).encode(), "bad_shape: "),
    "other steps": (lambda: rollout(obs=np.zeros((4, 2, 4), np.float32)).encode(), "bad_shape: "),
    "another task": (lambda: rollout(action=np.zeros((3, 2, 6), np.float32)).encode(), "bad_shape: "),
    "a number that is none": (lambda: rollout(reward=nan_reward()).encode(), "not_finite: reward"),
    "another's slot": (lambda: rollout(slot=1).encode(), "bad_key: a rollout of slot 1 was pushed on"),
    "a stranger": (lambda: rollout(incarnation="b").encode(), "incarnation: "),
    "another run": (lambda: rollout(run="run-2").encode(), "run: "),
    "an old policy": (lambda: rollout(policy_version=4).encode(), "stale: "),
    "a gap": (lambda: rollout(seq=1).encode(), "gap: "),
}


def test_what_is_no_use_is_refused_and_stays_out_of_the_log(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """Each with its reason, which is counted; what is good is taken afterwards all the same."""
    learner, actor = learners(), actors()
    actor.join("a")
    for what, (make, reason) in MALFORMED.items():
        reply = actor.push_bytes(make())
        assert reply.status == "refused", what
        assert reply.reason.startswith(reason), what
    assert learner.hub.rollouts(0.0) is None
    good = rollout()
    assert actor.push(good).status == "accepted"
    assert learner.logged() == [good.encode()]
    # In MALFORMED: 2 that are no msgpack, 3 of another shape, one of each of the others.
    assert learner.hub.refusals() == {
        "not_msgpack": 2,
        "missing_field": 1,
        "schema": 1,
        "unknown_field": 1,
        "bad_dtype": 1,
        "bad_shape": 3,
        "not_finite": 1,
        "bad_key": 1,
        "incarnation": 1,
        "run": 1,
        "stale": 1,
        "gap": 1,
    }


def test_a_full_queue_makes_the_actor_wait(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """A rollout that would fill more than `queue_bytes` is not taken now; it is no fault and is not counted as one."""
    size = len(rollout().encode())
    learner, actor = learners(transport={"queue_bytes": size - 1}), actors()
    actor.join("a")
    assert actor.push(rollout()) == PushReply("busy", "the learner's queue is full")
    assert learner.logged() == []
    assert learner.hub.refusals() == {}


def test_when_the_log_has_failed_nothing_is_used(
    learners: Callable[..., Learner], actors: Callable[[], Actor], caplog: pytest.LogCaptureFixture
) -> None:
    """Who pushes is not kept waiting, and the rollout is not given out."""
    learner, actor = learners(actors=1, num_envs=2), actors()
    actor.join("a")
    learner.writer.close()
    with pytest.raises(SessionError, match="no answer"):
        actor.push(rollout())
    assert learner.hub.rollouts(0.0) is None
    with pytest.raises(LogWriteError):
        learner.writer.write("/rollout", b"")
    assert "a handler of" in caplog.text


# -- who is there ------------------------------------------------------------------------------------------


def test_an_actor_whose_session_closes_is_lost(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Its slot is free at once, the next one in it is the next generation, and the user is told."""
    learner, actor, other = learners(), actors(), actors()
    actor.join("a")
    other.join("b")
    actor.session.declare_alive(KEYS.alive("actor", "a"))
    assert other.session is not actor.session
    actor.session.close()
    until(lambda: learner.hub.actors() == 1)
    reply = other.join("c")
    assert (reply.slot, reply.generation) == (0, 1)
    told = [learner.events.get(timeout=DEADLINE_S) for _ in range(4)]
    assert told[2] == ("warning", "actor_lost", "slot 0: a is gone")


def test_actors_that_leave_after_the_end_are_not_lost(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Their slots are freed without a warning."""
    learner, actor = learners(), actors()
    actor.join("a")
    actor.session.declare_alive(KEYS.alive("actor", "a"))
    learner.events.get(timeout=DEADLINE_S)
    learner.hub.finish()
    actor.session.close()
    until(lambda: learner.hub.actors() == 0)
    assert learner.events.empty()


def test_a_silent_actor_is_dropped(
    learners: Callable[..., Learner], actors: Callable[[], Actor], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An actor that is connected and sends no heartbeat loses its slot; who beats stays."""
    learner, actor = learners(), actors()
    actor.join("a")
    learner.events.get(timeout=DEADLINE_S)
    learner.hub.drop_silent()
    assert learner.hub.actors() == 1
    monkeypatch.setattr(hub_module, "SILENT_S", -1.0)
    learner.hub.drop_silent()
    assert learner.hub.actors() == 0
    assert learner.events.get(timeout=DEADLINE_S)[1] == "actor_lost"
    assert actor.push(rollout()).reason.startswith("incarnation: ")


# -- what the learner tells --------------------------------------------------------------------------------


def test_a_late_joiner_gets_the_snapshot_as_it_was_published(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """The newest one, byte for byte, whenever it is asked for."""
    learner, actor = learners(), actors()
    assert actor.ask(KEYS.policy_latest, b"") == snapshot(0).encode()
    published = learner.hub.begin(snapshot(1))
    served = actor.ask(KEYS.policy_latest, b"")
    assert served == published
    assert Snapshot.decode(served).version == 1


def test_orders_tell_the_newest_snapshot_and_what_is_wanted(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Said when a version begins, when an actor is ready or lost, and when the run is over."""
    learner, actor = learners(), actors()
    heard: list[Orders] = []
    actor.session.subscribe(KEYS.policy_notify, lambda key, data: heard.append(Orders.decode(data)))
    actor.join("a")
    actor.join("b")

    def said(**wanted: Any) -> Callable[[], bool]:
        def is_said() -> bool:
            learner.hub.announce()
            return bool(heard) and all(getattr(heard[-1], name) == value for name, value in wanted.items())

        return is_said

    until(said(version=0, collect={0: 1, 1: 1}))
    data = learner.hub.begin(snapshot(1))
    until(said(version=1, digest=snapshot(1).digest, size=len(data)))
    beats = actor.session.publisher(KEYS.heartbeat(1))
    learner.hub.ask_for_evaluation(8)
    until(said(collect={}, evaluate={}))
    # Nobody is ready, until slot 1 says so; from then on orders are said without being repeated.
    beats.put(heartbeat(1, "b", "waiting").encode())
    until(lambda: heard[-1].evaluate == {1: 8})
    learner.hub.finish()
    until(lambda: heard[-1].finished)


def test_metrics_and_status_are_published(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """For whoever subscribes."""
    learner, actor = learners(), actors()
    heard: Queue[tuple[str, bytes]] = Queue()
    actor.session.subscribe(KEYS.metrics, lambda *sample: heard.put(sample))
    actor.session.subscribe(KEYS.status, lambda *sample: heard.put(sample))
    wanted = {(KEYS.metrics, b'{"a":1}'), (KEYS.status, b"{}")}
    found: set[tuple[str, bytes]] = set()

    def both() -> bool:
        # Until the subscriptions have reached the learner, what it publishes goes to nobody.
        learner.hub.publish_metrics(b'{"a":1}')
        learner.hub.publish_status(b"{}")
        while not heard.empty():
            found.add(heard.get())
        return found == wanted

    until(both)


def test_malformed_heartbeats_are_counted(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """And do no harm."""
    learner, actor = learners(), actors()
    beats = actor.session.publisher(KEYS.heartbeat(0))

    def counted() -> bool:
        beats.put(b"hello")
        return learner.hub.refusals().get("not_msgpack", 0) > 0

    until(counted)
    assert actor.join().accepted


# -- the evaluation ----------------------------------------------------------------------------------------


def test_an_evaluation_is_taken_from_who_holds_the_slot(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """Of the version that is wanted; a repeat is accepted, anything else refused."""
    learner, actor = learners(), actors()
    actor.join("a")
    learner.hub.begin(snapshot(3))
    learner.hub.ask_for_evaluation(2)

    def push(*place: Any) -> PushReply:
        return PushReply.decode(actor.ask(KEYS.evaluation(0), evaluation(*place).encode()))

    for place in ((0, "a", 2), (0, "stranger", 3), (1, "a", 3)):
        assert push(*place) == PushReply("refused", "stale: this evaluation was not asked for"), place
    assert PushReply.decode(actor.ask(KEYS.evaluation(0), b"hello")).reason.startswith("not_msgpack: ")
    assert learner.hub.evaluation(0.0) is None
    assert push(0, "a", 3).status == "accepted"
    assert push(0, "a", 3).status == "accepted"
    found = learner.hub.evaluation(0.0)
    assert found is not None
    assert (found.version, found.episode_return.tolist(), found.episode_length.tolist()) == (3, [10, 30], [5, 7])


def test_handlers_do_not_wait_for_each_other(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """While rollouts wait for a slow disk, joins and snapshots are answered."""
    learner, actor = learners(), actors()
    actor.join("a")
    learner.log.hold()
    answered = threading.Event()

    def push() -> None:
        actor.push(rollout(0, "a"))
        answered.set()

    pusher = threading.Thread(target=push)
    pusher.start()
    until(lambda: learner.log.waiting == 1)
    assert actor.join("b").accepted
    assert actor.ask(KEYS.policy_latest, b"") == snapshot(0).encode()
    assert not answered.is_set()
    learner.log.let_one_go()
    pusher.join(DEADLINE_S)
    assert answered.is_set()


def test_a_snapshot_carries_the_digest_of_its_arrays() -> None:
    """What an actor decodes, it can trust."""
    arrays = snapshot(4).arrays
    made = make_snapshot(RUN, 4, arrays)
    assert Snapshot.decode(made.encode()).digest == snapshot(4).digest
