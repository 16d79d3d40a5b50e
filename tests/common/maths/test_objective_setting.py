"""`algorithm.objective`: the networks' objective is a setting of every learner."""

from __future__ import annotations

import pytest
from small_learners import SmallLearner, probe_learner, random_batch, same_bits, small_learner

from common.maths import trees


def with_objective(name: str, objective: str) -> SmallLearner:
    settings = probe_learner(name).settings
    algorithm = settings.algorithm.model_copy(update={"objective": objective})
    return small_learner(settings.model_copy(update={"algorithm": algorithm}), 1, 1)


@pytest.mark.parametrize(("name", "objective", "same_as"), [("ppo", "dpo", "dpo"), ("dpo", "clip", "ppo")])
def test_the_objective_is_all_that_tells_ppo_from_dpo(name: str, objective: str, same_as: str) -> None:
    """ppo with DPO's drift is dpo and dpo with the clip is ppo, bit for bit, over two updates."""
    ours, theirs = with_objective(name, objective), probe_learner(same_as)
    our_state, their_state = ours.start, theirs.start
    for seed in range(2):
        batch = random_batch(theirs, seed)
        our_state, _ = ours.step(our_state, batch)
        their_state, _ = theirs.step(their_state, batch)
    assert same_bits(trees.to_arrays(our_state), trees.to_arrays(their_state))


@pytest.mark.parametrize(("name", "own"), [("reskpn", "clip"), ("dpo-res", "dpo"), ("origin-kernel", "clip")])
def test_auto_is_the_learners_own(name: str, own: str) -> None:
    """Without the setting a learner trains by what its row of the table says; the clip for what has nothing else."""
    assert probe_learner(name).update.objective == own
