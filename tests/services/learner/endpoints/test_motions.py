"""Trajectories and diverged simulations as the learner takes them: checked, bounded in number, and in the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hub_sides import KEYS, Actor, Learner
from samples import RUN, evaluation, snapshot

from common.log.reader import LogReader
from common.wire.assessment import Assessment
from common.wire.divergence import Divergence
from common.wire.messages import ACCEPTED, PushReply
from common.wire.motion import Motion, Motions, pack
from services.learner.endpoints import divergences as divergences_module

Learners = Callable[..., Learner]
Actors = Callable[[], Actor]


def motion(steps: int, qpos: int = 2, qvel: int = 2, action: int = 1) -> Motion:
    """As of inverted_pendulum, whose cart and pole have a position and a velocity each."""
    sizes = ((steps, qpos), (steps, qvel), (steps, action), (steps,))
    return Motion(*(np.full(size, 0.25, np.float32) for size in sizes))


def packed(*made: Motion, version: int = 0, run: str = RUN) -> np.ndarray:
    return pack(made, run=run, version=version, step_s=0.5)


def assessment(motions: np.ndarray, version: int = 0) -> bytes:
    """Two episodes of 5 and 7 steps."""
    returns, lengths, none = np.float32([10, 30]), np.int32([5, 7]), np.zeros((0, 2), np.float32)
    return Assessment(RUN, "e", version, returns, lengths, none, 0.5, motions).encode()


def divergence(slot: int = 0, **changes: Any) -> bytes:
    made = motion(4)
    values: dict[str, Any] = {
        "run": RUN, "slot": slot, "incarnation": "a", "generation": 0, "seq": 1, "policy_version": 0, "env": 1,
        "step": 2, "step_s": 0.5, "qpos": made.qpos, "qvel": made.qvel, "action": made.action, "reward": made.reward,
    }  # fmt: skip
    return Divergence(**values | changes).encode()


def replied(side: Actor, key: str, data: bytes) -> PushReply:
    return PushReply.decode(side.ask(key, data))


def logged(learner: Learner, topic: str) -> list[bytes]:
    return [message.data for message in LogReader(learner.directory).messages({topic})]


@pytest.fixture
def evaluator(actors: Actors) -> Callable[[], Actor]:
    def make() -> Actor:
        side = actors()
        assert side.join("e", role="evaluator").accepted
        return side

    return make


def test_an_evaluation_brings_its_trajectories(learners: Learners, evaluator: Callable[[], Actor]) -> None:
    """They are logged under the name of the evaluator in /eval, whatever the message says."""
    learner = learners(evaluation={"trajectories": 2})
    assert replied(evaluator(), KEYS.assessment("e"), assessment(packed(motion(5), motion(3)))) == ACCEPTED
    (data,) = logged(learner, "/motion")
    found = Motions.decode(data)
    assert (found.source, found.version, found.lengths.tolist()) == ("evaluator-e", 0, [5, 3])


@pytest.mark.parametrize(
    ("motions", "slug"),
    [
        (packed(motion(5), version=1), "bad_value"),
        (packed(motion(5), run="run-2"), "bad_value"),
        (packed(motion(6)), "bad_shape"),  # the first episode has 5 steps
        (packed(motion(5), motion(7)), "bad_shape"),  # one trajectory of each evaluation is logged by default
        (packed(motion(5, qpos=3)), "bad_shape"),
        (packed(motion(5, action=2)), "bad_shape"),
        (np.zeros(3, np.uint8), "not_msgpack"),
    ],
)
def test_trajectories_that_do_not_fit(
    learners: Learners, evaluator: Callable[[], Actor], motions: np.ndarray, slug: str
) -> None:
    """Refused with their evaluation; the log has neither."""
    learner = learners()
    reply = replied(evaluator(), KEYS.assessment("e"), assessment(motions))
    assert (reply.status, reply.slug) == ("refused", slug)
    assert logged(learner, "/motion") == logged(learner, "/eval") == []


def test_only_so_many_evaluations_leave_trajectories(learners: Learners, evaluator: Callable[[], Actor]) -> None:
    """With two: the third evaluation is logged without. A resumed run counts those in its log."""
    learner = learners(evaluation={"trajectory_records": 2}, logged_records={"/motion": 1})
    side = evaluator()
    for version in range(3):
        learner.hub.publish(snapshot(version))
        data = assessment(packed(motion(5), version=version), version)
        assert replied(side, KEYS.assessment("e"), data) == ACCEPTED
    assert len(logged(learner, "/eval")) == 3
    assert len(logged(learner, "/motion")) == 1


def test_the_final_evaluation_brings_them_too(learners: Learners, actors: Actors) -> None:
    """And is refused where they do not fit."""
    learner, side = learners(), actors()
    side.join("a")
    learner.hub.ask_for_evaluation(2)
    sent = evaluation(0, "a")
    too_long = replace(sent, motions=packed(motion(int(sent.episode_length[0]) + 1), version=sent.version))
    assert replied(side, KEYS.evaluation(0), too_long.encode()).slug == "bad_shape"
    fitting = replace(sent, motions=packed(motion(int(sent.episode_length[0])), version=sent.version))
    assert replied(side, KEYS.evaluation(0), fitting.encode()) == ACCEPTED
    found = learner.hub.evaluation(1.0)
    assert found is not None
    np.testing.assert_array_equal(found.motions, fitting.motions)


def test_a_diverged_simulation_is_logged_as_it_came(learners: Learners, actors: Actors) -> None:
    """Of the actor that holds its slot."""
    learner, side = learners(), actors()
    side.join("a")
    assert replied(side, KEYS.divergence(0), divergence()) == ACCEPTED
    assert logged(learner, "/divergence") == [divergence()]


@pytest.mark.parametrize(
    ("changes", "slug"),
    [
        ({"incarnation": "b"}, "incarnation"),
        ({"run": "run-2"}, "incarnation"),
        ({"slot": 1}, "bad_key"),
        ({"step": 3}, "bad_value"),  # rollouts have 3 steps of 2 environments
        ({"env": 2}, "bad_value"),
        ({"qvel": np.zeros((4, 3), np.float32)}, "bad_shape"),
    ],
)
def test_records_that_are_refused(learners: Learners, actors: Actors, changes: dict[str, Any], slug: str) -> None:
    """Each for its reason, and counted."""
    learner, side = learners(), actors()
    side.join("a")
    reply = replied(side, KEYS.divergence(0), divergence(**changes))
    assert (reply.status, reply.slug) == ("refused", slug)
    assert logged(learner, "/divergence") == []
    assert sum(learner.hub.refusals().values()) == 1


def test_a_run_keeps_so_many_diverged_simulations(learners: Learners, actors: Actors) -> None:
    """With three, and one in the log of before: two more. The rest is surplus, which an actor does not send again."""
    learner, side = learners(log={"divergences": 3}, logged_records={"/divergence": 1}), actors()
    side.join("a")
    replies = [replied(side, KEYS.divergence(0), divergence(seq=seq)) for seq in range(4)]
    assert [reply.status for reply in replies] == ["accepted", "accepted", "refused", "refused"]
    assert replies[-1].slug == "surplus"
    assert len(logged(learner, "/divergence")) == 2


def test_not_all_of_one_moment(learners: Learners, actors: Actors, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two at once, where the next is due in a million seconds."""
    monkeypatch.setattr(divergences_module, "BURST", 2)
    monkeypatch.setattr(divergences_module, "PER_S", 1e-6)
    learner, side = learners(), actors()
    side.join("a")
    replies = [replied(side, KEYS.divergence(0), divergence(seq=seq)) for seq in range(3)]
    assert [reply.slug for reply in replies] == ["", "", "surplus"]
    assert len(logged(learner, "/divergence")) == 2
