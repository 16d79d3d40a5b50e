"""The tail of a resumed run's log, and whether acting can reproduce it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest
from samples import recorded_update, rollout

from common.errors import LogReadError
from common.runs.recorded_updates import RecordedUpdate
from common.wire.rollout import Rollout
from services.learner.resume.tail import Tail, divergence
from services.learner.scheduling.comparison import first_divergence as diff
from services.learner.scheduling.slots import Start


def pair(version: int) -> list[Rollout]:
    """The rollouts of two slots whose actors have been there since version 0."""
    return [rollout(slot, "ab"[slot], version, version) for slot in (0, 1)]


def updates(*versions: int) -> Iterator[RecordedUpdate]:
    return (recorded_update(version, f"d{version}", pair(version - 1)) for version in versions)


def test_a_tail_gives_what_belongs_to_a_version() -> None:
    """Used rollouts by their update, unused ones by the version they were made for, nothing beyond."""
    unused = pair(5)[:1]
    tail = Tail(5, updates(4, 5), [*unused, *pair(6)])
    assert [made.seq for made in tail.rollouts(3)] == [3, 3]
    found = tail.after(4)
    assert found is not None
    assert (found.version, found.state_digest) == (5, "d5")
    assert tail.after(4) is found
    assert tail.rollouts(5) == unused
    assert tail.after(5) is None
    assert [made.id for made in tail.rollouts(6)] == [(0, 0, 6), (1, 0, 6)]
    assert tail.rollouts(7) == []
    with pytest.raises(LogReadError, match="no update 5, but one to 5"):
        Tail(5, updates(4)).after(4)


def test_a_new_run_has_no_tail() -> None:
    """Nothing is logged yet, whatever the version."""
    tail = Tail()
    assert tail.after(0) is None
    assert tail.rollouts(0) == []
    assert not tail.holds("/policy", 10)


def test_records_that_are_there_already() -> None:
    """What belongs to a logged update, and what was written ahead of one; an evaluation only where it was found."""
    tail = Tail(5, ahead=[("/policy", 6)])
    assert [tail.holds("/policy", version) for version in (5, 6, 7)] == [True, True, False]
    assert [tail.holds("/episode", version) for version in (5, 6)] == [True, False]
    assert not tail.holds("/eval", 5)
    assert Tail(5, ahead=[("/eval", 5)]).holds("/eval", 5)


# -- comparing ---------------------------------------------------------------------------------------------


def test_the_same_rollout_made_again_does_not_differ() -> None:
    """By whom, when and how fast is of no matter; a number that is not finite is equal to itself."""
    old = rollout(1, "a", 4, 7)
    made = dataclasses.replace(old, incarnation="b", t_ns=99, timing={"collect": 9.0}, obs=old.obs.copy())
    assert diff(old, made) is None
    broken = np.full((3, 2), np.nan, np.float32)
    assert diff(dataclasses.replace(old, reward=broken), dataclasses.replace(made, reward=broken.copy())) is None


def test_what_differs_is_named() -> None:
    """Field, index and both values; a zero of the other sign is another zero."""
    old = rollout(1, "a", 4, 7, reward=np.zeros((3, 2), np.float32))
    reward = old.reward.copy()
    reward[2, 1] = 0.5
    assert diff(old, dataclasses.replace(old, reward=reward)) == "reward[2, 1] is 0.0 in the log and 0.5 now"
    minus = old.reward.copy()
    minus[0, 0] = -0.0
    assert diff(old, dataclasses.replace(old, reward=minus)) == "reward[0, 0] is 0.0 in the log and -0.0 now"
    ended = dataclasses.replace(old, episode_return=np.ones(1, np.float32))
    assert diff(old, ended) == "episode_return has shape [0] in the log and [1] now"
    assert diff(old, dataclasses.replace(old, policy_version=8)) == "policy 7 acted in the log, policy 8 now"


STARTS = [Start(0, 3), Start(2, 1)]


def test_a_run_without_losses_can_be_acted_again() -> None:
    """Every slot goes on from its start, one rollout a version; of the last version and the next some may be there."""
    whole = [{(0, 0, 3), (1, 2, 1)}, {(0, 0, 4), (1, 2, 2)}]
    assert divergence(STARTS, whole, [], 10) is None
    assert divergence(STARTS, whole, [[(1, 2, 3)], []], 10) is None
    assert divergence(STARTS, [], [[(0, 0, 3)], []], 10) is None
    assert divergence(STARTS, [], [[(0, 0, 3), (1, 2, 1)], [(1, 2, 2)]], 10) is None


@pytest.mark.parametrize(
    ("places", "unused"),
    [
        ([{(0, 0, 3), (1, 3, 0)}], []),
        ([{(0, 0, 3), (0, 0, 4)}], []),
        ([{(0, 0, 3)}], []),
        ([{(0, 0, 3), (1, 2, 2)}], []),
        ([], [[(1, 3, 0)], []]),
    ],
    ids=["successor", "other slot's work", "too few", "gap", "unused of a successor"],
)
def test_a_run_with_losses_cannot(
    places: list[set[tuple[int, int, int]]], unused: list[list[tuple[int, int, int]]]
) -> None:
    """What a successor made began with environments that are nowhere kept."""
    assert divergence(STARTS, places, unused, 10) == (
        "version 10 of the run was not acted by one and the same actor in every slot"
    )
