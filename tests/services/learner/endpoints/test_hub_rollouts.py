"""The hub's answers to rollouts, over real sessions on loopback and with a real log."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hub_sides import DEADLINE_S, KEYS, Actor, Learner
from samples import heartbeat, rollout, snapshot

from common.errors import LogWriteError
from common.wire import codec
from common.wire.messages import ACCEPTED, PushReply


def test_a_rollout_is_accepted_once_it_is_in_the_log(
    learners: Callable[..., Learner], actors: Callable[[], Actor]
) -> None:
    """At the moment of the answer the log's files hold the bytes that were sent, and nothing else."""
    learner, actor = learners(), actors()
    actor.join("a")
    made = rollout(0, "a")
    assert actor.push(made) == ACCEPTED
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
        assert answer.result(DEADLINE_S) == ACCEPTED
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
    learner.hub.publish(snapshot(1))
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
        assert f"{reply.slug}: {reply.text}".startswith(reason), what
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
    assert actor.push(rollout()) == PushReply.busy("queue_full", "the learner's queue is full")
    assert learner.logged() == []
    assert learner.hub.refusals() == {}


def test_when_the_log_has_failed_nothing_is_used(
    learners: Callable[..., Learner], actors: Callable[[], Actor], caplog: pytest.LogCaptureFixture
) -> None:
    """Who pushes is not kept waiting, the rollout is not given out, and no handler fails."""
    learner, actor = learners(actors=1, num_envs=2), actors()
    actor.join("a")
    learner.writer.close()
    assert actor.push(rollout()) == PushReply.busy("log_failed", "the log cannot be written any more: the run stops")
    assert not caplog.records
    assert learner.hub.rollouts(0.0) is None
    with pytest.raises(LogWriteError):
        learner.writer.write("/rollout", b"")


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


def test_a_policy_that_no_actor_can_act_by(
    learners: Callable[..., Learner], actors: Callable[[], Actor], until: Callable[..., None]
) -> None:
    """Three actors, one after the other in the slot, whose rollouts are not finite: the hub says that it is the policy.

    What somebody without the slot pushes is no evidence.
    """
    learner, actor = learners(actors=1, num_envs=2), actors()
    nan = np.full((3, 2), np.nan, np.float32)
    for name in ("a", "b", "c"):
        for stranger in ("x", "y", "z"):
            assert actor.push(rollout(0, stranger, reward=nan)).status == "refused"
        assert learner.hub.policy_problem() is None
        assert actor.join(name).accepted
        assert actor.push(rollout(0, name, reward=nan)).status == "refused"
        if name != "c":
            learner.hub._remove(name, "is gone")
    problem = learner.hub.policy_problem()
    assert problem is not None
    assert "3 actors in succession made rollouts with policy 0" in problem
