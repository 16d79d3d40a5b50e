"""A recorded run on the keys of a live one."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorded_runs import UPDATES, Recording, made_up, write_log
from samples import snapshot

from common.errors import RefusedError, SessionError
from common.log.reader import LogMessage
from common.runs.recorded_run import RecordedRun, open_run
from common.wire.assessment import Assessment
from common.wire.keys import Keys
from common.wire.messages import Orders, Snapshot
from common.wire.rollout import Rollout
from common.wire.session import Session
from services.evaluator.link import EvaluatorLink
from services.replay.player import Player
from services.replay.service import LONGEST_PAUSE_S, Recorded, at_pace, run_player
from services.worker.joining import join

KEYS = Keys("run-1")
READY = "reskpn/v1/run-1/alive/dashboard/d"


@pytest.fixture(scope="module")
def recording() -> Recording:
    """With a policy of version 3 at the end."""
    made = made_up()
    return Recording([*made.messages, ("/policy", snapshot(3).encode())], {})


@pytest.fixture
def run(recording: Recording, tmp_path: Path) -> RecordedRun:
    return open_run(write_log(tmp_path / "x", recording.messages))


def test_subscribers_see_the_run(
    run: RecordedRun, recording: Recording, sessions: Callable[..., Session], until: Callable[..., None]
) -> None:
    """Every record, status and rollout in order, and the policy announced and served; all of it, at once."""
    players, dashboard = sessions(listen=True), sessions()
    got: dict[str, list[bytes]] = {}
    here = threading.Event()
    for key in (KEYS.metrics, KEYS.status, KEYS.policy_notify, KEYS.rollouts):
        dashboard.subscribe(key, lambda key, data: got.setdefault(key, []).append(data))
    # Declarations arrive in order: who sees the token knows the subscriptions.
    dashboard.declare_alive(READY)
    players.watch_alive(READY, lambda _, alive: here.set() if alive else None)
    until(here.is_set)

    player = Player(run, players)
    for message, content in run.messages():
        player.play(message, content)
    player.finish()
    until(lambda: len(got.get(KEYS.policy_notify, ())) == 2)
    until(lambda: len(got.get(KEYS.status, ())) == UPDATES)

    records = [json.loads(data) for data in got[KEYS.metrics]]
    assert records == [content for _, content in recording.of("/update")]
    status = [json.loads(data) for data in got[KEYS.status]]
    assert [one["version"] for one in status] == [1, 2, 3, 4]
    assert [one["env_steps"] for one in status] == [12, 24, 36, 48]
    # episodes of 7 and 9 ended at update 2
    assert [one["train_return"] for one in status] == [None, 8.0, 8.0, 8.0]
    # update 1 was logged two messages, 0.2 s, after the first rollout
    assert status[0]["steps_per_s"] == pytest.approx(60.0)
    assert (status[0]["actors"], status[0]["slots"], status[0]["total_steps"]) == (2, 2, 48)
    rewards = [Rollout.decode(got[KEYS.rollout(slot)][0]).reward for slot in (0, 1)]
    assert status[0]["step_reward"] == pytest.approx(np.mean(rewards))
    slots = [[Rollout.decode(data).key for data in got[KEYS.rollout(slot)]] for slot in (0, 1)]
    assert slots[0] == [(0, "life-0", seq) for seq in range(UPDATES)]
    assert slots[1] == [*((1, "life-1", seq) for seq in range(UPDATES)), (1, "late", 0)]
    orders = [Orders.decode(data) for data in got[KEYS.policy_notify]]
    assert [(one.version, one.finished) for one in orders] == [(3, False), (3, True)]
    served = Snapshot.decode(dashboard.ask(KEYS.policy_latest, b"", 5.0))
    assert (served.version, served.digest) == (3, orders[0].digest)


def test_an_evaluator_follows_a_replay(
    run: RecordedRun,
    sessions: Callable[..., Session],
    until: Callable[..., None],
) -> None:
    """It joins as it joins a learner, is told the newest policy at once, and hears the end."""
    players, worker = sessions(listen=True), sessions()
    player = Player(run, players)
    for message, content in run.messages():
        player.play(message, content)
    stop = threading.Event()
    member = join(
        worker, run="", physics="native", versions={}, hardware={}, stop=stop, waiting=str, role="evaluator",
        timeout_s=5.0,
    )  # fmt: skip
    assert member is not None
    assert (member.run, member.settings) == ("run-1", run.settings)
    link = EvaluatorLink(worker, member, push_timeout_s=5.0)
    # The last policy was announced before it joined, and no other follows.
    orders = link.orders(newer_than=None, timeout_s=5.0)
    assert orders is not None
    assert (orders.version, link.snapshot().version) == (3, 3)
    found = Assessment(
        run=member.run, evaluator=member.incarnation, version=3, episode_return=np.ones(1, np.float32),
        episode_length=np.ones(1, np.int32), qpos=np.zeros((0, 2), np.float32), step_s=0.1,
    )  # fmt: skip
    assert link.push(found, stop)
    player.finish()
    until(lambda: link.over)


def test_an_actor_cannot_work_for_a_replay(
    run: RecordedRun,
    sessions: Callable[..., Session],
) -> None:
    """It is refused for good, with the reason; and so is an evaluator of another run."""
    players, worker = sessions(listen=True), sessions()
    Player(run, players)
    for role, wanted, text in (("actor", "", "only evaluators can join"), ("evaluator", "other", "not of 'other'")):
        with pytest.raises(RefusedError, match=rf"this is a replay of run 'run-1'.*{text}"):
            join(
                worker, run=wanted, physics="native", versions={}, hardware={}, stop=threading.Event(), waiting=str,
                role=role, timeout_s=5.0,
            )  # fmt: skip


class Stop(threading.Event):
    """A clock that moves as it is waited on."""

    def __init__(self, stop_at_s: float = float("inf")) -> None:
        super().__init__()
        self.now_s = 100.0
        self._stop_at_s = stop_at_s

    def wait(self, timeout: float | None = None) -> bool:
        self.now_s += timeout or 0.0
        return self.now_s >= self._stop_at_s


def messages(*seconds: float) -> list[Recorded]:
    return [(LogMessage("/event", int(1e9 * at), 0, b""), None) for at in seconds]


def played_s(stop: Stop, rate: float, recorded: list[Recorded]) -> list[float]:
    return [stop.now_s for _ in at_pace(iter(recorded), rate, stop, lambda: stop.now_s)]


@pytest.mark.parametrize(("rate", "expected"), [(1.0, [0.0, 1.0, 3.0]), (2.0, [0.0, 0.5, 1.5]), (0.5, [0.0, 2.0, 6.0])])
def test_the_pace_is_the_runs_times_the_rate(rate: float, expected: list[float]) -> None:
    """Pauses of 1 s and 2 s in the log."""
    assert [at - 100.0 for at in played_s(Stop(), rate, messages(50, 51, 53))] == pytest.approx(expected)


def test_long_pauses_are_shortened() -> None:
    """A run that was resumed after an hour, or a clock that went back, is not waited for."""
    found = played_s(Stop(), 1.0, messages(0, 3600, 3601, 10))
    assert [at - 100.0 for at in found] == [0.0, LONGEST_PAUSE_S, LONGEST_PAUSE_S + 1, LONGEST_PAUSE_S + 1]


def test_a_slow_subscriber_does_not_shift_the_pace() -> None:
    """What took 3 s to publish eats up the pauses that follow."""
    stop = Stop()
    found = []
    for _ in at_pace(iter(messages(0, 2, 4)), 1.0, stop, lambda: stop.now_s):
        found.append(stop.now_s - 100.0)
        stop.now_s += 3.0 if len(found) == 1 else 0.0
    assert found == [0.0, 3.0, 4.0]


def test_stopping_ends_the_pace() -> None:
    """In the middle of a pause."""
    assert played_s(Stop(stop_at_s=102.0), 1.0, messages(0, 1, 3, 4)) == [100.0, 101.0]


def test_a_player_plays_to_the_end(run: RecordedRun, endpoint: str) -> None:
    """Also where nobody listens; the address is free again afterwards. A player that is stopped says so."""
    seen: list[int] = []
    for _ in range(2):
        assert run_player(
            run,
            endpoint,
            rate=None,
            delay_s=0.0,
            stop=threading.Event(),
            on_update=lambda update: seen.append(update.version),
        )
    assert seen == [1, 2, 3, 4] * 2
    stop = threading.Event()
    stop.set()
    assert not run_player(run, endpoint, rate=1.0, delay_s=60.0, stop=stop, on_update=lambda _: None)


def test_an_address_in_use_is_said(run: RecordedRun, endpoint: str, sessions: Callable[..., Session]) -> None:
    """As it is where a learner listens there."""
    sessions(listen=True)
    with pytest.raises(SessionError, match="is in use"):
        run_player(run, endpoint, rate=None, delay_s=0.0, stop=threading.Event(), on_update=lambda _: None)
