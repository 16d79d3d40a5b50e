"""A run that is shown from what its learner publishes."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from dashboard_runs import update
from reports import actor, progress, report

from common.errors import SessionError
from common.wire.credentials import NO_CREDENTIALS
from common.wire.endpoint import free_port
from common.wire.keys import STATUS, Keys
from common.wire.report import EvaluationReport
from common.wire.session import Session, open_session
from services.dashboard.collection import RunCollection
from services.dashboard.learner_link import first_report
from services.dashboard.live_run import LiveRun, WatchedLearner
from services.dashboard.run_view import Cursor

RUN = "hopper-ppo-s0-ab12"
DEADLINE_S = 20.0


def serve(endpoint: str, answer: Callable[[], bytes]) -> Session:
    session = open_session(listen=[endpoint], max_message_size=1 << 20)
    session.serve(STATUS, lambda request: request.reply(answer()))
    return session


def until(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    pause = threading.Event()
    while not condition():
        assert time.monotonic() < end_s, "deadline passed"
        pause.wait(0.02)


def content(run: LiveRun) -> dict[str, Any]:
    run.poll()
    found, _ = run.view.since(Cursor())
    assert found is not None
    return found


def test_actors_that_come_and_go_are_events() -> None:
    run = LiveRun(report(actors=[]))
    run.take(report())
    run.take(report(actors=[actor(1)]))
    run.lost()
    run.lost()
    run.take(report(actors=[actor(1)]))
    assert [event["text"] for event in content(run)["events"]] == [
        "slot 0: actor 5f31aa00 is there",
        "slot 1: actor 5f31aa00 is there",
        "slot 0: actor 5f31aa00 is gone",
        "the learner does not answer",
        "the learner answers again",
    ]


def test_the_newest_evaluation_is_a_point() -> None:
    """Each once, however often it is reported."""
    found = EvaluationReport(
        version=5, env_steps=50, episodes=16, return_mean=3.5, return_std=0.5, length_mean=9.0, source="e", behind=2,
        ago_s=1.0,
    )  # fmt: skip
    run = LiveRun(report())
    run.take(report(evaluation=found))
    run.take(report(evaluation=found))
    assert [(one["version"], one["return_mean"]) for one in content(run)["evaluations"]] == [(5, 3.5)]


def test_a_learner_that_does_not_answer_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run whose updates are all made is over instead."""
    monkeypatch.setattr("services.dashboard.live_run.FRESH_S", -1.0)
    run, over = LiveRun(report()), LiveRun(report(progress=progress(version=100, updates=100)))
    assert content(run)["state"]["notice"] == "waiting for the learner at tcp/127.0.0.1:7447: it does not answer"
    assert content(over)["state"]["phase"] == "finished"


def test_nobody_at_the_address() -> None:
    """One sentence that says what may be wrong."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(SessionError, match=f"no connection to {endpoint} within 3 s"):
        first_report(endpoint, NO_CREDENTIALS)


def test_updates_are_drawn_as_they_are_published_and_a_restart_is_survived(
    stop: threading.Event, tmp_path: Path
) -> None:
    """A learner publishes update 8, dies, comes back with the same run, publishes 9, then another with another run."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    runs = RunCollection([], NO_CREDENTIALS, stop)
    name = [RUN]

    def answer() -> bytes:
        return report(run=name[0], endpoint=endpoint).encode()

    def publish(learner: Session, version: int) -> None:
        """Until it has arrived: a subscriber of a learner that has just started may not be known yet."""
        publisher = learner.publisher(Keys(RUN).metrics)

        def arrived() -> bool:
            publisher.put(json.dumps(update(version)).encode())
            (run,) = runs.looked_at([RUN])
            return bool(run.view.latest.get("version") == version)

        until(arrived)

    with serve(endpoint, answer) as learner:
        WatchedLearner(endpoint, NO_CREDENTIALS, first_report(endpoint, NO_CREDENTIALS), runs.add, stop).start()
        publish(learner, 8)
    (run,) = runs.looked_at(runs.default())
    assert isinstance(run, LiveRun)
    until(lambda: not run._answers)
    with serve(endpoint, answer) as learner:
        publish(learner, 9)
        found = content(run)
        assert found["columns"]["version"] == [8, 9]
        assert found["state"]["since"] == "curves begin at update 8, when this page connected to the learner"
        name[0] = "hopper-ppo-s1-cd34"
        until(lambda: len(runs.entries()) == 2)
    stop.set()


def test_an_update_that_is_none_is_passed_over(stop: threading.Event) -> None:
    """Of another run behind the same router, or without content."""
    runs = RunCollection([], NO_CREDENTIALS, stop)
    watched = WatchedLearner("tcp/127.0.0.1:9", NO_CREDENTIALS, report(), runs.add, stop)
    watched._on_update("another", update(1))
    watched._on_update(RUN, {})
    (run,) = runs.looked_at([RUN])
    assert run.view.latest == {}
