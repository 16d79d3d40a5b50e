"""What the hub gives evaluators, what it takes from them, and that training does not notice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hub_sides import KEYS, Actor, Learner
from samples import RUN, rollout, snapshot

from common.config.sources import parse_json
from common.log.reader import LogReader
from common.wire.assessment import Assessment
from common.wire.messages import ACCEPTED, PushReply
from services.learner.endpoints import evaluators as evaluators_module
from services.learner.reporting.curves import points_of_evaluation
from services.learner.reporting.evaluations import is_of_the_run


def assessment(name: str = "e", version: int = 0, **changes: Any) -> Assessment:
    """Returns 10 and 30, lengths 5 and 7, and the first two positions of a joint."""
    values: dict[str, Any] = {
        "run": RUN, "evaluator": name, "version": version, "step_s": 0.5,
        "episode_return": np.float32([10, 30]), "episode_length": np.int32([5, 7]),
        "qpos": np.float32([[0.25], [1 / 3]]),
    }  # fmt: skip
    return Assessment(**values | changes)


def push(evaluator: Actor, given: Assessment, key: str = "") -> PushReply:
    return PushReply.decode(evaluator.ask(key or KEYS.assessment(given.evaluator), given.encode()))


def logged(learner: Learner, topic: str) -> list[dict[str, Any]]:
    return [message.json() for message in LogReader(learner.directory).messages({topic})]


@pytest.fixture
def evaluator(actors: Callable[[], Actor]) -> Callable[[str], Actor]:
    """Makes an evaluator that has joined and shows that it is alive."""

    def make(name: str) -> Actor:
        side = actors()
        assert side.join(name, role="evaluator").accepted
        side.session.declare_alive(KEYS.alive("evaluator", name))
        return side

    return make


def test_joining_gives_settings_and_no_slot(learners: Callable[..., Learner], actors: Callable[[], Actor]) -> None:
    """The slots are the actors'; the run does not count evaluators among them."""
    learner, side = learners(seed=5), actors()
    reply = side.join("e", role="evaluator")
    assert (reply.accepted, reply.run, reply.restore) == (True, RUN, False)
    assert parse_json(reply.settings) == learner.settings
    assert learner.hub.actors() == 0
    assert [side.join(name).slot for name in "ab"] == [0, 1]
    assert learner.hub.report().totals.joined == 2


def test_what_it_brings_is_logged(learners: Callable[..., Learner], evaluator: Callable[[str], Actor]) -> None:
    """As one /eval and one /trajectory, by its environment steps (12 an update), with how far it was behind."""
    learner = learners()
    side = evaluator("e")
    learner.hub.publish(snapshot(4))
    assert push(side, assessment(version=3)) == ACCEPTED
    expected = {
        "version": 3, "env_steps": 36, "episodes": 2, "return_mean": 20.0, "return_std": 10.0, "return_min": 10.0,
        "return_max": 30.0, "length_mean": 6.0, "length_std": 1.0, "source": "evaluator-e", "behind": 1,
    }  # fmt: skip
    assert logged(learner, "/eval") == [expected]
    steps = [{"time_s": 0.0, "qpos": [0.25]}, {"time_s": 0.5, "qpos": [0.333333]}]
    assert logged(learner, "/trajectory") == [{"version": 3, "source": "evaluator-e", "steps": steps}]
    assert learner.hub.evaluators.fresh() == [expected]
    assert learner.hub.evaluators.fresh() == []
    assert points_of_evaluation(expected) == {
        "eval/return": 20.0,
        "eval/return_std": 10.0,
        "eval/length": 6.0,
        "charts/eval_return": 20.0,
    }


def test_it_is_acknowledged_once_it_is_in_the_log(
    learners: Callable[..., Learner], evaluator: Callable[[str], Actor], until: Callable[..., None]
) -> None:
    """And not before; a repeat meanwhile or later adds nothing."""
    learner = learners()
    side = evaluator("e")
    learner.log.hold()
    with pytest.raises(Exception, match="no answer"):
        side.session.ask(KEYS.assessment("e"), assessment().encode(), 0.2)
    assert learner.hub.report().evaluation is None
    learner.log.let_one_go()
    until(lambda: learner.hub.report().evaluation is not None)
    assert push(side, assessment()) == ACCEPTED
    assert len(logged(learner, "/eval")) == 1


def test_two_evaluators_may_judge_the_same_version(
    learners: Callable[..., Learner], evaluator: Callable[[str], Actor]
) -> None:
    """Both are in the log, under their names; positions that were not kept give no /trajectory."""
    learner = learners()
    for name in ("e", "f"):
        none = np.zeros((0, 1), np.float32)
        assert push(evaluator(name), assessment(name, qpos=none)).status == "accepted"
    assert [(record["version"], record["source"]) for record in logged(learner, "/eval")] == [
        (0, "evaluator-e"),
        (0, "evaluator-f"),
    ]
    assert logged(learner, "/trajectory") == []


def test_the_report_shows_the_newest(
    learners: Callable[..., Learner], evaluator: Callable[[str], Actor], until: Callable[..., None]
) -> None:
    """And how many evaluators are here: one that goes is not; how far behind is counted up to now."""
    learner = learners()
    side = evaluator("e")
    until(lambda: learner.hub.report().evaluators == 1)
    assert push(side, assessment()).status == "accepted"
    learner.hub.publish(snapshot(2))
    found = learner.hub.report().evaluation
    assert found is not None
    assert (found.version, found.return_mean, found.source, found.behind) == (0, 20.0, "evaluator-e", 2)
    assert 0.0 <= found.ago_s < 15.0
    side.session.close()
    until(lambda: learner.hub.report().evaluators == 0)
    assert learner.hub.report().evaluation is not None


def test_nobody_speaks_for_the_run(learners: Callable[..., Learner], evaluator: Callable[[str], Actor]) -> None:
    """An evaluator whose name is that of the run's own evaluation is told apart; a long name is told in part."""
    learner = learners()
    for name in ("run", "5f31aa0012bb34cc"):
        assert push(evaluator(name), assessment(name)).status == "accepted"
    records = logged(learner, "/eval")
    assert [record["source"] for record in records] == ["evaluator-run", "evaluator-5f31aa00"]
    assert not any(map(is_of_the_run, records))
    assert is_of_the_run({"version": 3, "source": "run"})
    assert is_of_the_run({"version": 3})  # of the first release


def test_what_is_refused(learners: Callable[..., Learner], evaluator: Callable[[str], Actor]) -> None:
    """Strangers, other runs, versions that were never published, another's key, actors; each is counted."""
    learner = learners()
    side = evaluator("e")
    side.join("a")
    reasons = {
        push(side, assessment("stranger")).slug: "incarnation",
        push(side, assessment("a")).text: "'a' is no evaluator",
        push(side, assessment(run="run-2")).slug: "incarnation",
        push(side, assessment(version=1)).text: "version is 1; the newest is 0",
        push(side, assessment(), KEYS.assessment("f")).slug: "bad_key",
    }
    assert all(expected in found for found, expected in reasons.items()), reasons
    learner.hub.finish()
    assert push(side, assessment()) == PushReply.refused("stale", "the run is over")
    assert learner.hub.report().refusals == {"assessment": {"incarnation": 3, "bad_value": 1, "bad_key": 1, "stale": 1}}
    assert logged(learner, "/eval") == []


def test_an_evaluator_may_not_act(learners: Callable[..., Learner], evaluator: Callable[[str], Actor]) -> None:
    """Its name holds no slot: a rollout under it is refused, and none is logged."""
    learner = learners()
    assert evaluator("e").push(rollout(0, "e")).status == "refused"
    assert learner.logged() == []


def test_the_runs_end_does_not_wait_for_it(
    learners: Callable[..., Learner], actors: Callable[[], Actor], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither for one that is there nor for one that found no room; who asks afterwards is told that it is over."""
    monkeypatch.setattr(evaluators_module, "MAX_EVALUATORS", 1)
    learner, side = learners(), actors()
    assert side.join("e", role="evaluator").accepted
    full = side.join("f", role="evaluator")
    assert (full.accepted, full.final, full.text) == (
        False,
        False,
        "all 1 places for evaluators are taken; end one of them",
    )
    learner.hub.finish()
    assert (learner.hub.actors(), learner.hub.standing_by()) == (0, False)
    late = side.join("g", role="evaluator")
    assert (late.accepted, late.finished) == (False, True)


def test_one_that_never_showed_up_makes_room(
    learners: Callable[..., Learner], evaluator: Callable[[str], Actor], monkeypatch: pytest.MonkeyPatch,
    until: Callable[..., None],
) -> None:  # fmt: skip
    """After a while, for one that asks then; one that is alive keeps its place."""
    monkeypatch.setattr(evaluators_module, "MAX_EVALUATORS", 2)
    learner = learners()
    side = evaluator("alive")
    until(lambda: learner.hub.report().evaluators == 1)
    assert side.join("lost", role="evaluator").accepted
    assert not side.join("new", role="evaluator").accepted
    monkeypatch.setattr(evaluators_module, "UNSEEN_S", -1.0)
    assert side.join("new", role="evaluator").accepted
    assert push(side, assessment("alive")).status == "accepted"
    assert push(side, assessment("lost")).status == "refused"


def test_assessments_are_limited_in_rate(
    learners: Callable[..., Learner], evaluator: Callable[[str], Actor], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Room for one and a half messages, and hardly any new: the first is logged, the second is to come later."""
    size = len(assessment().encode())
    monkeypatch.setattr(evaluators_module, "BURST_BYTES", size * 3 // 2)
    monkeypatch.setattr(evaluators_module, "BYTES_PER_S", 1e-6)
    learner = learners()
    learner.hub.publish(snapshot(3))
    side = evaluator("e")
    assert push(side, assessment(version=1)) == ACCEPTED
    later = push(side, assessment(version=2))
    assert (later.status, later.slug) == ("busy", "rate_limited")
    assert push(side, assessment(version=1)) == ACCEPTED  # a duplicate costs nothing
    assert [record["version"] for record in logged(learner, "/eval")] == [1]
