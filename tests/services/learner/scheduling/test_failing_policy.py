"""A policy that no actor can act by, told from an actor that cannot act."""

from __future__ import annotations

import pytest
from samples import rollout

from services.learner.scheduling.failing_policy import FailingPolicy


@pytest.mark.parametrize("slug", ["not_finite", "too_big"])
def test_three_actors_in_succession_are_evidence(slug: str) -> None:
    """Each a new one: an actor that repeats itself counts once."""
    failing = FailingPolicy()
    for name in ("a", "b", "b", "a"):
        failing.refused(slug, rollout(0, name, 0, 5), 5)
        assert failing.problem is None
    failing.refused(slug, rollout(0, "c", 0, 5), 5)
    assert failing.problem is not None
    assert "3 actors in succession made rollouts with policy 5" in failing.problem


def test_one_that_can_act_exonerates_the_policy() -> None:
    """Before or after the others failed: then it is their machines."""
    failing = FailingPolicy()
    failing.accepted(rollout(1, "good", 0, 5), 5)
    for name in "abcd":
        failing.refused("not_finite", rollout(0, name, 0, 5), 5)
    assert failing.problem is None


def test_other_refusals_and_versions_do_not_count() -> None:
    """A rollout of another shape says nothing of the policy; each version begins without evidence."""
    failing = FailingPolicy()
    for name in "abcd":
        failing.refused("bad_shape", rollout(0, name, 0, 5), 5)
        failing.refused("not_finite", rollout(0, name, 0, 4), 5)
    assert failing.problem is None
    for version, name in ((5, "a"), (5, "b"), (6, "c"), (6, "d")):
        failing.refused("not_finite", rollout(0, name, 0, version), version)
    assert failing.problem is None
