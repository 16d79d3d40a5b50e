"""What who is let in may do: attacks by clients, to whom the learner would pass on what others send, if it might.

Every attack is made on a learner without access control as well, where it works.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

import pytest
from guarded_sides import KEYS, REFUSED_S, GuardedLearner, Outside, until
from samples import RUN, STATUS_NOW, heartbeat, question, rollout, snapshot

from common.config.settings import TransportSettings
from common.errors import SessionError
from common.wire.credentials import NO_CREDENTIALS, Credentials
from common.wire.endpoint import free_port
from common.wire.keys import JOIN, Keys
from common.wire.messages import Orders, Snapshot
from common.wire.session import Request

Learners = Callable[[TransportSettings], GuardedLearner]
CLIENT = {"mode": "client"}


@dataclass
class Run:
    """A learner, an actor at work, and an attacker."""

    learner: GuardedLearner
    worker: Outside
    attacker: Outside


@pytest.fixture(params=["actor", "viewer", "anyone"])
def role(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def run(
    role: str, secured: TransportSettings, certificates: Path, learners: Learners, outside: Callable[..., Outside]
) -> Run:
    """The attacker is an actor or a viewer; "anyone": nobody is asked who he is."""
    transport = secured if role != "anyone" else TransportSettings(endpoint=f"tcp/127.0.0.1:{free_port()}")
    learner = learners(transport)

    def credentials(name: str) -> Credentials:
        return NO_CREDENTIALS if role == "anyone" else Credentials(certificates / name)

    worker = outside(transport.endpoint, credentials("actor"), CLIENT)
    attacker = outside(transport.endpoint, credentials(role), CLIENT)
    assert worker.join("worker").slot == 0
    attacker.report()
    return Run(learner, worker, attacker)


def settled(run: Run) -> None:
    """All that the attacker has sent so far has been dealt with, and what followed from it has reached the worker."""
    run.attacker.report()
    run.worker.report()


def test_an_answer_cannot_be_forged(run: Run, role: str) -> None:
    """Who serves the learner's keys beside it is not asked."""
    forged = snapshot(9).encode()
    asked = Queue[str]()

    def answer(request: Request) -> None:
        asked.put(request.key)
        request.reply(forged)

    other = Keys("run-2").policy_latest  # which the learner does not serve: an answer is the attacker's
    for key in (KEYS.policy_latest, KEYS.rollout(0), other):
        run.attacker.session.serve(key, answer)
    settled(run)
    if role == "anyone":
        assert run.worker.ask(other) == forged
        return
    with pytest.raises(SessionError):
        run.worker.session.ask(other, b"", REFUSED_S)
    assert {run.worker.ask(KEYS.policy_latest) for _ in range(20)} == {snapshot(0).encode()}
    assert run.worker.push(rollout(0, "worker")).status == "accepted"
    assert asked.empty()


def test_orders_cannot_be_forged(run: Run, role: str) -> None:
    """What others put on the learner's keys reaches nobody; what the learner puts does."""
    heard = Queue[bool]()
    run.worker.session.subscribe(KEYS.policy_notify, lambda key, data: heard.put(Orders.decode(data).finished))
    run.worker.report()
    publisher = run.attacker.session.publisher(KEYS.policy_notify)
    publisher.put(Orders(RUN, 9, "d", 1, {0: 1}, {}, True, 1).encode())
    settled(run)
    run.learner.hub.announce()
    until(lambda: False in heard.queue)
    assert (True in heard.queue) == (role == "anyone")


def test_nobody_else_passes_for_a_learner(run: Run, role: str) -> None:
    """A token of a learner is not seen unless it is the learner's own."""
    seen = Queue[str]()
    run.learner.session.watch_alive(f"reskpn/v1/{RUN}/alive/learner/*", lambda key, alive: seen.put(key))
    run.attacker.session.declare_alive(KEYS.alive("learner", "other"))
    settled(run)
    until(lambda: KEYS.alive("learner", "learner") in seen.queue)
    if role == "anyone":
        until(lambda: KEYS.alive("learner", "other") in seen.queue)
    assert (KEYS.alive("learner", "other") in seen.queue) == (role == "anyone")


def test_the_secrets_of_others_are_not_heard(run: Run, role: str) -> None:
    """Heartbeats, rollouts and tokens, which say who holds a slot, reach nobody but the learner."""
    heard = Queue[str]()
    run.attacker.session.subscribe("reskpn/v1/**", lambda key, data: heard.put(key))
    run.attacker.session.subscribe(KEYS.heartbeats, lambda key, data: heard.put(key))
    run.attacker.session.watch_alive(KEYS.all_alive, lambda key, alive: heard.put(key))
    settled(run)
    beat = run.worker.session.publisher(KEYS.heartbeat(0))
    run.worker.session.declare_alive(KEYS.alive("actor", "worker"))
    until(
        lambda: (
            beat.put(heartbeat(0, "worker", "collecting").encode())
            or run.worker.report().actors[0].state == "collecting"
        )
    )
    settled(run)
    secrets = {KEYS.heartbeat(0), KEYS.alive("actor", "worker")}
    assert bool(secrets & set(heard.queue)) == (role == "anyone")


def test_metrics_are_for_viewers(run: Run, role: str) -> None:
    """An actor does not hear them."""
    heard = Queue[str]()
    run.attacker.session.subscribe(KEYS.metrics, lambda key, data: heard.put(key))
    run.attacker.session.subscribe(KEYS.status, lambda key, data: heard.put(key))
    settled(run)
    run.learner.hub.publish_metrics(b"{}")
    run.learner.hub.publish_progress(STATUS_NOW)
    if role == "actor":
        settled(run)
        assert heard.empty()
    else:
        assert {heard.get(timeout=15), heard.get(timeout=15)} == {KEYS.metrics, KEYS.status}


def test_a_viewer_only_watches(run: Run, role: str) -> None:
    """It reads the report, and may neither join nor push nor fetch the policy nor pass for an actor."""
    if role != "viewer":
        assert run.attacker.join("second").slot == 1
        return
    session = run.attacker.session
    attempts = {JOIN: question("v").encode(), KEYS.rollout(0): rollout(0, "worker").encode(), KEYS.policy_latest: b""}
    for key, payload in attempts.items():
        with pytest.raises(SessionError):
            session.ask(key, payload, REFUSED_S)
    session.publisher(KEYS.heartbeat(0)).put(heartbeat(0, "worker", "collecting").encode())
    session.declare_alive(KEYS.alive("actor", "worker"))
    settled(run)
    report = run.attacker.report()
    assert [(actor.slot, actor.state, actor.accepted) for actor in report.actors] == [(0, "compiling", 0)]
    assert run.learner.logged() == 0
    session.close()
    assert [actor.slot for actor in run.worker.report().actors] == [0]


@pytest.mark.parametrize("role", ["actor"], indirect=True)
def test_another_actors_slot(run: Run) -> None:
    """An actor cannot act for a slot whose incarnation it does not know; that it tried is counted."""
    secret = "0123456789abcdef" * 2
    assert run.worker.join(secret).slot == 1
    run.attacker.session.declare_alive(KEYS.alive("actor", "guess"))
    shown = {actor.slot: actor.incarnation for actor in run.attacker.report().actors}
    assert shown == {0: "worker", 1: "01234567"}
    assert run.attacker.push(rollout(1, shown[1])).slug == "incarnation"
    run.attacker.session.publisher(KEYS.heartbeat(1)).put(heartbeat(1, shown[1], "collecting").encode())
    run.attacker.session.publisher(KEYS.heartbeat(0)).put(heartbeat(0, "guess", "collecting").encode())
    until(lambda: run.attacker.report().refusals == {"rollout": {"incarnation": 1}, "heartbeat": {"incarnation": 2}})
    run.attacker.session.close()
    assert len(run.worker.report().actors) == 2
    assert run.worker.push(rollout(1, secret)).status == "accepted"


@pytest.mark.parametrize("role", ["actor"], indirect=True)
def test_a_late_joiner_gets_the_policy(run: Run) -> None:
    """The newest, by asking for it, though it was published before it came."""
    run.learner.hub.publish(snapshot(3))
    assert Snapshot.decode(run.attacker.ask(KEYS.policy_latest)).version == 3
    orders = Queue[int]()
    run.attacker.session.subscribe(KEYS.policy_notify, lambda key, data: orders.put(Orders.decode(data).version))
    run.attacker.report()
    run.learner.hub.announce()
    assert orders.get(timeout=15) == 3
