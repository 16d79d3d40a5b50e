"""Messages of the right form and the wrong sender."""

from __future__ import annotations

from typing import Any

import pytest
from samples import RUN, evaluation, heartbeat, question

from common.errors import CodecError
from common.wire.keys import Keys
from services.learner.endpoints.admission import check_evaluation, check_heartbeat, check_join
from services.learner.scheduling.fleet import Fleet

KEYS = Keys(RUN)


@pytest.fixture
def fleet() -> Fleet:
    """ "a" holds slot 0 of two; two episodes of version 3 are asked for."""
    fleet = Fleet(RUN, 2)
    fleet.join("a", "native", 0.0)
    fleet.begin(3)
    fleet.evaluate(2)
    return fleet


def test_the_right_sender_passes(fleet: Fleet) -> None:
    """Without a word."""
    check_join(question())
    check_heartbeat(fleet, KEYS, KEYS.heartbeat(0), heartbeat(0, "a"))
    check_evaluation(fleet, KEYS, KEYS.evaluation(0), evaluation(0, "a", 3))


@pytest.mark.parametrize(
    ("slot", "changes", "reason"),
    [
        (1, {}, "bad_key"),
        (0, {"run": "run-2"}, "run"),
        (0, {"incarnation": "b"}, "incarnation"),
        (1, {"slot": 1}, "incarnation"),
    ],
)
def test_heartbeats_of_others(fleet: Fleet, slot: int, changes: dict[str, Any], reason: str) -> None:
    """On another key, of another run, of one that does not hold the slot, of a slot that nobody holds."""
    with pytest.raises(CodecError) as caught:
        check_heartbeat(fleet, KEYS, KEYS.heartbeat(slot), heartbeat(**{"slot": 0, "incarnation": "a"} | changes))
    assert caught.value.reason == reason


@pytest.mark.parametrize("place", [(0, "a", 2), (0, "b", 3), (1, "a", 3)])
def test_evaluations_of_others(fleet: Fleet, place: tuple[int, str, int]) -> None:
    """Of another version, of a stranger, of another slot."""
    with pytest.raises(CodecError, match="was not asked for"):
        check_evaluation(fleet, KEYS, KEYS.evaluation(place[0]), evaluation(*place))


def test_an_evaluation_of_another_size(fleet: Fleet) -> None:
    """Episodes are as many as were asked for; none is taken before it is asked for."""
    fleet.evaluate(3)
    with pytest.raises(CodecError, match="was not asked for"):
        check_evaluation(fleet, KEYS, KEYS.evaluation(0), evaluation(0, "a", 3))
