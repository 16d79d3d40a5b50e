"""A resumed run up to the end of its log: compared with it, or given up for it."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Queue
from typing import Any

import numpy as np
import pytest
from samples import RUN, recorded_update, rollout, settings

from common.runs.recorded_updates import RecordedUpdate
from common.wire.rollout import Rollout
from services.learner.loop import TrainingLoop
from services.learner.resume.plan import Resumption
from services.learner.resume.resumed_replay import ResumedReplay
from services.learner.resume.tail import Tail
from services.learner.scheduling.slots import Start
from services.learner.training.checkpoints import Checkpoints

SETTINGS = settings(log={"checkpoint_every": 2})
FRESH_STARTS = (Start(1), Start(1))


class HubStandIn:
    """Keeps what it was asked for; `failed` is why acting again has failed."""

    def __init__(self) -> None:
        self.begun: list[dict[str, Any]] = []
        self.started_over: list[tuple[Any, Any, bool]] = []
        self.failed: str | None = None

    def publish(self, snapshot: Any, **wanted: Any) -> bytes:
        self.begun.append({"logged": (), "settled": ()} | wanted)
        return b""

    def divergence(self) -> str | None:
        return self.failed

    def start_over(self, starts: Any, settled: Any, *, collect: bool) -> None:
        self.started_over.append((starts, settled, collect))
        self.failed = None


def pair(version: int) -> list[Rollout]:
    return [rollout(slot, "ab"[slot], version, version) for slot in (0, 1)]


def updates() -> Iterator[RecordedUpdate]:
    return (recorded_update(version, f"d{version}", pair(version - 1)) for version in (5, 6))


@pytest.fixture
def resumption() -> Resumption:
    """From version 4; the log has updates 5 and 6, and one rollout of version 6."""
    return Resumption("r", 4, {}, (Start(0, 4), Start(0, 4)), FRESH_STARTS, Tail(6, updates(), pair(6)[:1]))


class TrainerStandIn:
    """A trainer that is at the version it is told."""

    version = 0

    def digest(self) -> str:
        return ""

    def policy_arrays(self) -> dict[str, np.ndarray]:
        return {}


class Sides:
    def __init__(self, resumption: Resumption) -> None:
        self.hub = HubStandIn()
        self.events: Queue[tuple[str, str, str]] = Queue()
        hub: Any = self.hub
        self.again = ResumedReplay(hub, resumption, lambda *event: self.events.put(event))
        self.trainer = TrainerStandIn()
        trainer: Any = self.trainer
        nowhere: Any = None
        checkpoints = Checkpoints(RUN, Path())
        self.loop = TrainingLoop(SETTINGS, trainer, hub, nowhere, checkpoints, self.again, threading.Event())

    def begin(self, version: int) -> dict[str, Any]:
        """Publish that version as the learner's loop does; returns what the hub was asked to collect with it."""
        self.trainer.version = version
        self.loop.publish()
        return self.hub.begun[-1]


def places(rollouts: list[Rollout]) -> list[tuple[int, int, int]]:
    return [one.id for one in rollouts]


def test_the_actors_act_again(resumption: Resumption) -> None:
    """Up to the end of the log they are compared with it; environments are asked for where none are kept."""
    sides = Sides(resumption)
    begun = [sides.begin(version) for version in (4, 5, 6, 7, 8)]
    assert [places(one["logged"]) for one in begun] == [
        [(0, 0, 4), (1, 0, 4)],
        [(0, 0, 5), (1, 0, 5)],
        [(0, 0, 6)],
        [],
        [],
    ]
    assert [one["hand_in"] for one in begun] == [False, False, True, False, True]
    assert all(one["collect"] and one["settled"] == () for one in begun)
    assert [sides.again.covers(version) for version in (4, 5, 6)] == [True, True, False]
    assert sides.again.logged_rollouts(4) is None
    assert not sides.again.fall_back_to_log(4)
    assert sides.events.empty()


def test_rollouts_of_the_version_after_the_last(resumption: Resumption) -> None:
    """They are compared with what is made again, and settled where nobody acts again."""
    ahead = [*pair(6), pair(7)[1]]
    sides = Sides(dataclasses.replace(resumption, tail=Tail(6, updates(), ahead)))
    begun = [sides.begin(version) for version in (4, 5, 6, 7, 8)]
    assert [places(one["logged"]) for one in begun[2:]] == [[(0, 0, 6), (1, 0, 6)], [(1, 0, 7)], []]
    by_log = Sides(dataclasses.replace(resumption, tail=Tail(6, updates(), ahead), log_only_reason="an actor was lost"))
    begun = [by_log.begin(version) for version in (4, 5, 6, 7)]
    assert [places(one["settled"]) for one in begun[2:]] == [[(0, 0, 6), (1, 0, 6)], [(1, 0, 7)]]
    assert by_log.begin(8)["settled"] == ()


def test_the_last_version_collects_nothing(resumption: Resumption) -> None:
    """As in any run."""
    sides = Sides(resumption)
    assert sides.begin(10)["collect"] is False
    assert sides.hub.begun[-1]["hand_in"] is False


def test_without_acting_the_log_decides(resumption: Resumption) -> None:
    """Nobody collects before its end; there, the rollouts that no update has used are settled."""
    sides = Sides(dataclasses.replace(resumption, log_only_reason="an actor was lost"))
    assert sides.events.get_nowait()[1] == "resumed_by_log"
    assert sides.begin(4)["collect"] is False
    found = sides.again.logged_rollouts(4)
    assert found is not None
    assert places(found) == [(0, 0, 4), (1, 0, 4)]
    sides.begin(5)
    begun = sides.begin(6)
    assert (begun["collect"], begun["logged"], places(begun["settled"])) == (True, (), [(0, 0, 6)])
    assert sides.again.logged_rollouts(6) is None


def test_acting_again_that_fails_is_given_up(resumption: Resumption) -> None:
    """Said once, with what differed; every slot begins anew, and the rest of the log decides."""
    sides = Sides(resumption)
    sides.begin(4)
    sides.hub.failed = "reward differs"
    assert sides.again.fall_back_to_log(4)
    level, name, text = sides.events.get_nowait()
    assert (level, name) == ("warning", "resumed_differs")
    assert "acting again does not give what is in the log: reward differs. The updates up to 6 are made from" in text
    assert sides.hub.started_over == [(FRESH_STARTS, (), False)]
    found = sides.again.logged_rollouts(4)
    assert found is not None
    assert places(found) == [(0, 0, 4), (1, 0, 4)]


def test_acting_again_that_fails_at_the_end(resumption: Resumption) -> None:
    """What is logged of the last version counts, and the rest of it is collected."""
    sides = Sides(resumption)
    for version in (4, 5, 6):
        sides.begin(version)
    sides.hub.failed = "slot 0 lost its actor"
    assert sides.again.fall_back_to_log(6)
    ((starts, settled, collect),) = sides.hub.started_over
    assert (starts, places(settled), collect) == (FRESH_STARTS, [(0, 0, 6)], True)
    assert sides.again.logged_rollouts(6) is None


def test_digests_are_compared(resumption: Resumption) -> None:
    """The first that differs is told, with both; those that the log does not have cannot differ."""
    sides = Sides(resumption)
    for version in (4, 5, 6):
        sides.begin(version)
    sides.again.check(5, "d5")
    assert sides.events.empty()
    sides.again.check(6, "other")
    sides.again.check(7, "d7")
    level, name, text = sides.events.get_nowait()
    assert (level, name) == ("warning", "resumed_state_differs")
    assert "update 6, made again from the same rollouts, led to digest other where the log has d6" in text
    assert sides.events.empty()


def test_returns_go_on(resumption: Resumption) -> None:
    """Episodes before the checkpoint count, each with the mean of its update: of 20 updates the last two are late."""
    episodes = [{"version": 1, "count": 3, "return_mean": 2.0}, {"version": 19, "count": 2, "return_mean": 5.0}]
    returns = Sides(dataclasses.replace(resumption, episodes=episodes)).again.returns(20)
    assert (returns.episodes, returns.late, returns.newest) == (5, 5.0, 3.2)


def test_a_fresh_run_is_not_asked_about_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its policies are published without the code for resuming; environments are asked for at checkpoint versions."""
    sides = Sides(Resumption("r"))
    monkeypatch.delattr(ResumedReplay, "remaining")
    begun = [sides.begin(version) for version in (0, 1, 2, 10)]
    assert [(one["collect"], one["hand_in"]) for one in begun] == [
        (True, False),
        (True, False),
        (True, True),
        (False, False),
    ]
