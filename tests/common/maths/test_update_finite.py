"""Numbers that are not finite are named by the update and refused by the trainer."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from mirrors import no_mirror
from small_learners import probe_learner, random_batch, same_bits
from update_cases import in_the_middle, one_gradient_step

from common.config.settings import AlgorithmSettings, RunSettings
from common.errors import NumericsError
from common.maths import trees
from common.tasks import TASKS
from common.wire.rollout import Rollout
from services.learner.training.trainer import Trainer

PARTS = ("parameters", "optimiser", "expansion", "observation moments", "return moments", "gradient norm")


@pytest.mark.parametrize(
    ("field", "broken"),
    [
        # A reward goes into advantages and so into everything trained, and into the returns; not into observations.
        ("reward", {"parameters", "optimiser", "expansion", "return moments", "gradient norm"}),
        # An observation goes into everything but the returns.
        ("obs", {"parameters", "optimiser", "expansion", "observation moments", "gradient norm"}),
        # An action goes into ratios, and into the score of the drawn transition.
        ("action", {"parameters", "optimiser", "expansion", "gradient norm"}),
        # Nothing broken, nothing said.
        (None, set()),
    ],
)
def test_what_is_not_finite_is_named(field, broken):
    """One NaN in the batch: `finite/<part>` is 0 for exactly the parts that it reaches."""
    learner = one_gradient_step("reskpn")
    batch = random_batch(learner, seed=2)
    if field:
        values = np.array(getattr(batch, field))
        values[1, 2] = np.nan
        batch = replace(batch, **{field: jnp.asarray(values)})
    _, metrics = learner.step(in_the_middle(learner), batch)
    found = {
        name.removeprefix("finite/"): float(value) for name, value in metrics.items() if name.startswith("finite/")
    }
    assert found == {part: 0.0 if part in broken else 1.0 for part in PARTS}


def test_a_gradient_whose_norm_overflows_is_named():
    """Rewards of 1e25 make gradients of some 1e25: their squares pass 3e38, and clipping by the norm zeroes them."""
    learner = probe_learner("ppo")
    batch = random_batch(learner, seed=0)
    state, metrics = learner.step(learner.start, replace(batch, reward=1e25 * batch.reward))
    before, after = (trees.to_arrays(s.parameters["critic"]) for s in (learner.start, state))
    assert all(np.isfinite(array).all() for array in after.values())
    assert same_bits(before, after)
    flags = {name: float(value) for name, value in metrics.items() if name.startswith("finite/")}
    assert [name for name, finite in flags.items() if not finite] == ["finite/gradient norm"]


TINY_RUN = RunSettings(
    task="inverted_pendulum",
    learner="ppo",
    actors=1,
    num_envs=4,
    num_steps=2,
    total_steps=80,
    algorithm=AlgorithmSettings(epochs=1, minibatches=1, hidden=(3,)),
)


def rollout(seq: int, reward: float) -> Rollout:
    """A rollout that fits the tiny run, the same reward at every step."""
    rng = np.random.default_rng(seq)
    steps, envs, task = TINY_RUN.num_steps, TINY_RUN.num_envs, TASKS[TINY_RUN.task]

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    return Rollout(
        run="r",
        slot=0,
        incarnation="i",
        seq=seq,
        policy_version=seq,
        t_ns=0,
        obs=normal(steps, envs, task.observation_size),
        action=normal(steps, envs, task.action_size),
        log_prob=normal(steps, envs),
        reward=np.full((steps, envs), reward, np.float32),
        terminated=np.zeros((steps, envs), np.bool_),
        truncated=np.zeros((steps, envs), np.bool_),
        last_obs=normal(envs, task.observation_size),
        truncated_obs=np.zeros((0, task.observation_size), np.float32),
        episode_return=np.zeros(0, np.float32),
        episode_length=np.zeros(0, np.int32),
        timing={},
        **no_mirror(task.observation_size, task.action_size),
    )


def test_trainer_refuses_an_update_that_is_not_finite():
    """The error names the parts, the state stays as it was to the last bit, and the next good update goes through."""
    trainer = Trainer(TINY_RUN)
    trainer.update([rollout(0, 1.0)])
    digest = trainer.digest()
    with pytest.raises(NumericsError) as caught:
        trainer.update([rollout(1, float("nan"))])
    # A NaN reward reaches all that is trained and the returns' moments; ppo's empty expansion has nothing to break.
    assert "update 2 made the " in str(caught.value)
    for part in ("parameters", "optimiser", "return moments"):
        assert f"the {part} " in str(caught.value)
    for part in ("observation moments", "expansion"):
        assert f"the {part} " not in str(caught.value)
    assert trainer.version == 1
    assert trainer.digest() == digest
    metrics = trainer.update([rollout(1, 1.0)])
    assert trainer.version == 2
    assert trainer.digest() != digest
    assert not any(name.startswith("finite/") for name in metrics)
