"""The table of learners: what each is made of."""

from __future__ import annotations

import pytest

from common.learners import LEARNERS


@pytest.mark.parametrize(
    ("name", "rkhs", "objective"),
    # Paper: ResKPN has the RKHS part and PPO's clip; its baselines PPO and DPO have no RKHS part.
    [("reskpn", True, "ppo"), ("ppo", False, "ppo"), ("dpo", False, "dpo")],
)
def test_switches(name: str, rkhs: bool, objective: str) -> None:
    """A learner is its row of the table."""
    learner = LEARNERS[name]
    assert (learner.name, learner.rkhs, learner.objective) == (name, rkhs, objective)


def test_every_learner_explains_itself() -> None:
    """One line each, for --help."""
    for name, learner in LEARNERS.items():
        assert learner.name == name
        assert learner.text
        assert "\n" not in learner.text
