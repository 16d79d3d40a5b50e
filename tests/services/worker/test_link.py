"""The links of workers to their learner, with a learner that answers what the test has prepared."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import Any

import pytest
from learner_script import Script, ask_to_join
from samples import RUN, evaluation, heartbeat, rollout, settings, snapshot

from common.errors import RefusedError, SessionError
from common.log.reader import LogReader
from common.log.writer import LogWriter
from common.wire import codec
from common.wire.keys import Keys
from common.wire.messages import ACCEPTED, Orders, PushReply
from common.wire.rollout import Rollout
from common.wire.session import Request, Session
from services.actor.link import ActorLink
from services.learner.endpoints.hub import Hub
from services.worker.joining import Assignment
from services.worker.link import AssignmentLost

DEADLINE_S = 15.0
KEYS = Keys(RUN)
MEMBER = Assignment(RUN, 0, 0, "a", settings())

Sessions = Callable[..., Session]


def orders(**changes: Any) -> Orders:
    values: dict[str, Any] = {"run": RUN, "version": 1, "digest": "d", "size": 9, "collect": {0: 1}, "evaluate": {}}
    return Orders(**values | {"finished": False, "t_ns": 1} | changes)


@pytest.fixture
def stop() -> threading.Event:
    return threading.Event()


Linked = Callable[..., tuple[Session, ActorLink]]


@pytest.fixture
def linked(sessions: Sessions, until: Callable[..., None]) -> Linked:
    """A learner's session that answers pushes by a script, and the link of an actor that knows of it."""

    def make(
        pushes: Callable[[Request], None] | None = None, *, push_timeout_s: float = DEADLINE_S
    ) -> tuple[Session, ActorLink]:
        learner, session = sessions(listen=True), sessions()
        if pushes is not None:
            learner.serve(KEYS.rollouts, pushes)
            learner.serve(KEYS.evaluations, pushes)
        seen = threading.Event()
        session.watch_alive(KEYS.alive("learner", "learner"), lambda key, alive: seen.set())
        link = ActorLink(session, MEMBER, push_timeout_s=push_timeout_s)
        # Declared last: what was declared before is known when this is.
        learner.declare_alive(KEYS.alive("learner", "learner"))
        until(seen.is_set)
        return learner, link

    return make


def test_damaged_orders_are_passed_over(linked: Linked, caplog: pytest.LogCaptureFixture) -> None:
    """Without a word, for good ones follow: those are what the actor works by."""
    learner, link = linked()
    said = learner.publisher(KEYS.policy_notify)

    def newest() -> Orders | None:
        for data in (b"hello", heartbeat().encode(), orders(version=5).encode()):
            said.put(data)
        return link.orders(newer_than=None, timeout_s=0.05)

    deadline = time.monotonic() + DEADLINE_S
    while (heard := newest()) is None:
        assert time.monotonic() < deadline
    assert heard == orders(version=5)
    assert caplog.text == ""


# -- pushing -----------------------------------------------------------------------------------------------


def test_a_rollout_that_is_accepted(linked: Linked, stop: threading.Event) -> None:
    """Sent once, whole, on its slot's key."""
    pushes = Script(ACCEPTED.encode())
    _, link = linked(pushes)
    assert link.push(rollout(), stop)
    assert pushes.asked == [rollout().encode()]


def test_busy_then_accepted(linked: Linked, stop: threading.Event) -> None:
    """The same bytes again until the learner has room."""
    busy = PushReply("busy", "queue_full", "the learner's queue is full").encode()
    pushes = Script(busy, busy, ACCEPTED.encode())
    _, link = linked(pushes)
    assert link.push(rollout(), stop)
    assert pushes.asked == [rollout().encode()] * 3


def test_a_lost_answer_means_the_same_again(linked: Linked, stop: threading.Event) -> None:
    """After the timeout the same bytes are sent, so that the learner can know the repeat."""
    pushes = Script(None, None, ACCEPTED.encode())
    _, link = linked(pushes, push_timeout_s=0.2)
    assert link.push(rollout(), stop)
    assert pushes.asked == [rollout().encode()] * 3


@pytest.mark.parametrize("reason", ["stale: made with policy 0", "surplus: policy 1 has all"])
def test_what_is_of_no_use_any_more_is_not_taken(linked: Linked, stop: threading.Event, reason: str) -> None:
    """The actor goes on with what is wanted now."""
    _, link = linked(Script(PushReply.refused(*reason.split(": ")).encode()))
    assert not link.push(rollout(), stop)


@pytest.mark.parametrize("reason", ["incarnation: slot 0 is not held by 'a'", "gap: rollout 3 came where 2 is next"])
def test_an_actor_that_is_not_known_any_more_is_lost(linked: Linked, stop: threading.Event, reason: str) -> None:
    """It must join again."""
    _, link = linked(Script(PushReply.refused(*reason.split(": ")).encode()))
    with pytest.raises(AssignmentLost, match=reason[:20]):
        link.push(rollout(), stop)


@pytest.mark.parametrize(
    "reason", ["bad_shape: obs has shape (3,)", "run: this learner runs 'x'", "not_finite: reward"]
)
def test_what_is_malformed_is_not_sent_again(linked: Linked, stop: threading.Event, reason: str) -> None:
    """It would be no better the next time: the learner's reason is the error."""
    _, link = linked(Script(PushReply.refused(*reason.split(": ")).encode()))
    with pytest.raises(RefusedError, match=f"refused what this actor sent: {reason[:9]}"):
        link.push(rollout(), stop)


def test_pushing_can_be_stopped(linked: Linked, stop: threading.Event) -> None:
    """False, where `stop` is set while the learner is busy."""
    asked = []

    def stop_and_be_busy(request: Request) -> None:
        asked.append(request.payload)
        stop.set()
        request.reply(PushReply("busy", "", "").encode())

    _, link = linked(stop_and_be_busy)
    assert not link.push(rollout(), stop)
    assert asked == [rollout().encode()]


def test_an_evaluation_goes_the_same_way(linked: Linked, stop: threading.Event) -> None:
    """Sent again while the learner is busy, False where it is not wanted any more."""
    pushes = Script(
        PushReply("busy", "", "").encode(),
        ACCEPTED.encode(),
        PushReply("refused", "stale", "this evaluation was not asked for").encode(),
    )
    _, link = linked(pushes)
    assert link.push_evaluation(evaluation(), stop)
    assert pushes.asked == [evaluation().encode()] * 2
    assert not link.push_evaluation(evaluation(), stop)


def test_a_learner_that_goes_while_it_is_asked(
    linked: Linked, stop: threading.Event, until: Callable[..., None]
) -> None:
    """Whoever waits for its answer is lost, long before the timeout."""
    pushes = Script(None)
    learner, link = linked(pushes)
    with ThreadPoolExecutor(1) as pool:
        pushed = pool.submit(link.push, rollout(), stop)
        until(lambda: len(pushes.asked) == 1)
        learner.close()
        with pytest.raises(AssignmentLost, match="the learner is gone"):
            pushed.result(DEADLINE_S)


class LateLog:
    """A log that writes when it is told to. `pushes` counts the rollouts for which the hub asked it for room."""

    def __init__(self, log: LogWriter) -> None:
        self._log = log
        self.held: Queue[tuple[bytes, Callable[[], None]]] = Queue()
        self.pushes = 0

    @property
    def pending_bytes(self) -> int:
        self.pushes += 1
        return 0

    def write(self, topic: str, data: bytes, *, on_durable: Callable[[], None]) -> None:
        self.held.put((data, on_durable))

    def let_one_go(self) -> None:
        data, on_durable = self.held.get(timeout=DEADLINE_S)
        self._log.write("/rollout", data, on_durable=on_durable)


def test_a_rollout_whose_answer_was_lost_is_used_once(
    sessions: Sessions, stop: threading.Event, tmp_path: Path, until: Callable[..., None]
) -> None:
    """With the real learner's side: timeout, busy, accepted, and one rollout in the log and in the batch."""
    learner, session = sessions(listen=True), sessions()
    with LogWriter(tmp_path / "log") as writer:
        log: Any = LateLog(writer)
        hub = Hub(RUN, settings(actors=1, num_envs=2), learner, log, lambda *event: None)
        hub.publish(snapshot(0))
        hub.open()
        member = ask_to_join(session, stop)
        assert member is not None
        link = ActorLink(session, member, push_timeout_s=0.3)
        made = rollout(member.slot, member.incarnation)
        with ThreadPoolExecutor(1) as pool:
            pushed = pool.submit(link.push, made, stop)
            # The first push waits for the log; when the actor has given it up it asks again, and is told to wait.
            until(lambda: log.pushes >= 3)
            assert log.held.qsize() == 1
            assert not pushed.done()
            log.let_one_go()
            assert pushed.result(DEADLINE_S)
        taken = hub.rollouts(0.0)
        assert taken is not None
        assert [r.key for r in taken] == [made.key]
        learner.close()
    logged = [Rollout.decode(message.data).key for message in LogReader(tmp_path / "log").messages({"/rollout"})]
    assert logged == [made.key]


# -- orders, snapshots and signs of life -------------------------------------------------------------------


def test_orders_are_heard_when_they_change(linked: Linked, until: Callable[..., None]) -> None:
    """By version, digest, work or the end; the same said again later is nothing new, and there is None in time."""
    learner, link = linked()
    assert link.orders(newer_than=None, timeout_s=0.0) is None
    said = learner.publisher(KEYS.policy_notify)
    known: Orders | None = None
    changes: list[dict[str, Any]] = [
        {},
        {"version": 2},
        {"digest": "e"},
        {"collect": {0: 2}},
        {"evaluate": {0: 3}},
        {"finished": True},
    ]
    for change in changes:
        wanted = orders(**change)

        def is_heard(wanted: Orders = wanted, known: Orders | None = known) -> bool:
            said.put(wanted.encode())
            return link.orders(newer_than=known, timeout_s=0.05) == wanted

        until(is_heard)
        said.put(orders(**change, t_ns=2).encode())
        assert link.orders(newer_than=wanted, timeout_s=0.05) is None
        known = wanted


def test_a_snapshot_is_fetched(linked: Linked, until: Callable[..., None]) -> None:
    """Whole and checked by its digest; a damaged one, or none, means to begin anew."""
    learner, link = linked()
    with pytest.raises(AssignmentLost, match="no policy from the learner: no answer"):
        link.snapshot()
    damaged = codec.encode(codec.decode(snapshot(1).encode()) | {"digest": "0"})
    script = Script(damaged, snapshot(3).encode())
    learner.serve(KEYS.policy_latest, script)

    def damage_is_found() -> bool:
        with pytest.raises(AssignmentLost) as lost:
            link.snapshot()
        return "says digest '0'" in str(lost.value)

    until(damage_is_found)
    found = link.snapshot()
    assert (found.version, found.digest) == (3, snapshot(3).digest)


def test_a_learner_that_is_gone_is_noticed(linked: Linked) -> None:
    """Whoever waits for orders is told at once."""
    learner, link = linked()
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(link.orders, newer_than=None, timeout_s=DEADLINE_S)
        learner.close()
        with pytest.raises(AssignmentLost, match="the learner is gone"):
            waiting.result(DEADLINE_S)


def test_a_learner_that_leaves_after_the_run_is_not_missed(linked: Linked, until: Callable[..., None]) -> None:
    """Its last word counts for an actor that was busy, compiling for one, when it was said."""
    learner, link = linked()
    said, last = learner.publisher(KEYS.policy_notify), orders(finished=True)

    def is_heard() -> bool:
        said.put(last.encode())
        return link.orders(newer_than=None, timeout_s=0.05) == last

    until(is_heard)
    learner.close()
    assert link.orders(newer_than=last, timeout_s=DEADLINE_S) == last


def test_a_learner_that_was_gone_for_a_moment_was_gone(sessions: Sessions, until: Callable[..., None]) -> None:
    """It has given up this actor's slot: that it is back does not give the slot back."""
    learner, session = sessions(listen=True), sessions()
    alive: list[bool] = []
    heard = threading.Event()
    session.watch_alive(KEYS.alive("learner", "learner"), lambda key, there: alive.append(there))
    session.subscribe(KEYS.policy_notify, lambda key, data: heard.set())
    link = ActorLink(session, MEMBER, push_timeout_s=DEADLINE_S)
    learner.declare_alive(KEYS.alive("learner", "learner"))
    until(lambda: alive == [True])
    learner.close()
    until(lambda: alive == [True, False])
    again = sessions(listen=True)
    again.declare_alive(KEYS.alive("learner", "learner"))
    until(lambda: alive == [True, False, True])
    said = again.publisher(KEYS.policy_notify)

    def orders_come_through() -> bool:
        said.put(orders().encode())
        return heard.is_set()

    until(orders_come_through)
    with pytest.raises(AssignmentLost, match="the learner is gone"):
        link.orders(newer_than=None, timeout_s=DEADLINE_S)


def test_an_actor_shows_that_it_is_alive(linked: Linked, until: Callable[..., None]) -> None:
    """By a token under its own name, and by what it beats on its slot's key."""
    learner, link = linked()
    tokens: list[tuple[str, bool]] = []
    beats: list[bytes] = []
    learner.watch_alive(KEYS.all_alive, lambda *token: tokens.append(token))
    learner.subscribe(KEYS.heartbeats, lambda key, data: beats.append(data))
    until(lambda: (KEYS.alive("actor", "a"), True) in tokens)

    def beaten() -> bool:
        link.send_heartbeat(heartbeat())
        return heartbeat().encode() in beats

    until(beaten)


def test_a_closed_session_cannot_beat(sessions: Sessions) -> None:
    """The heartbeat's thread ends by it."""
    sessions(listen=True)
    session = sessions()
    link = ActorLink(session, MEMBER, push_timeout_s=1.0)
    session.close()
    with pytest.raises(SessionError):
        link.send_heartbeat(heartbeat())
