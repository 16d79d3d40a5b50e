"""Rollouts and evaluations: they are a function of policy, settings, slot and generation, and of nothing else."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from functools import partial

import jax
import numpy as np
import pytest
from samples import settings

from common.errors import CodecError
from common.maths.policy import Mean, Policy, act
from common.maths.rkhs.make import make_representation
from common.maths.trees import to_arrays
from common.physics.environments import BatchedEnvironment, make_environment
from common.wire.rollout import Rollout, RolloutShape
from services.actor.collector import COLLECT, RESET, Collector, SlotGeneration
from services.actor.rollouts import rollout_message
from services.worker.deterministic import DeterministicEpisodes, evaluate
from services.worker.joining import Assignment
from services.worker.policy_reader import PolicyReader

pytestmark = pytest.mark.usefixtures("in_a_hurry")
ENVS, STEPS, EPISODE = 4, 5, 7
ROLLOUTS = 8
SETTINGS = settings(
    actors=2, num_envs=2 * ENVS, num_steps=STEPS, total_steps=400, episode_length=EPISODE, rkhs={"capacity": 6}
)
HOLDER = SlotGeneration(slot=1, generation=2)
ASSIGNMENT = Assignment("r", 1, 2, "a", SETTINGS)


@pytest.fixture(scope="module")
def reader(in_a_hurry: None) -> PolicyReader:
    return PolicyReader(SETTINGS)


@pytest.fixture(scope="module")
def environment(in_a_hurry: None) -> BatchedEnvironment:
    """The environments to step by hand."""
    return make_environment("inverted_pendulum", "native", num_envs=ENVS, episode_length=EPISODE)


@pytest.fixture(scope="module")
def policy(reader: PolicyReader) -> Policy:
    """A policy in which every part is at work: noise on all parameters, centres with weights, whitened observations."""
    rng = np.random.default_rng(3)
    arrays = to_arrays(reader.initial())
    for path, array in arrays.items():
        if array.dtype == np.float32 and path.split("/")[0] in ("parameters", "expansion"):
            arrays[path] = array + rng.normal(0.0, 0.3, array.shape).astype(np.float32)
    arrays["observations/mean"] = rng.normal(0.0, 0.1, 4).astype(np.float32)
    arrays["observations/variance"] = rng.uniform(0.5, 2.0, 4).astype(np.float32)
    arrays["observations/count"] = np.array(30.0, np.float32)
    return reader.read(arrays)


def collect(collector: Collector, policy: Policy) -> Rollout:
    """The message of the collector's next rollout."""
    collected, timing = collector.collect(policy)
    return rollout_message(collected, ASSIGNMENT, seq=collector.seq, version=0, timing=timing)


def arrays_of(sent: Rollout) -> dict[str, np.ndarray]:
    """Its arrays, by the names of its fields."""
    return {name: value for name, value in vars(sent).items() if isinstance(value, np.ndarray)}


def make_collector(reader: PolicyReader, holder: SlotGeneration = HOLDER) -> Collector:
    collector = Collector(SETTINGS, holder, reader)
    collector.compile()
    return collector


@pytest.fixture(scope="module")
def used(reader: PolicyReader, policy: Policy) -> tuple[Collector, list[Rollout]]:
    """A collector whose rollouts were all kept, and those rollouts."""
    collector = make_collector(reader)
    made = []
    for _ in range(ROLLOUTS):
        made.append(collect(collector, policy))
        collector.keep()
    return collector, made


@pytest.fixture(scope="module")
def made(used: tuple[Collector, list[Rollout]]) -> list[dict[str, np.ndarray]]:
    return [arrays_of(sent) for sent in used[1]]


def assert_same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> None:
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name, strict=True)


def joined(made: list[dict[str, np.ndarray]], name: str) -> np.ndarray:
    """All rollouts as one, along time."""
    return np.concatenate([arrays[name] for arrays in made])


def test_a_rollout_fits_its_message(used: tuple[Collector, list[Rollout]]) -> None:
    """Shapes, dtypes and values are those that the learner checks."""
    for sent in used[1]:
        Rollout.decode(sent.encode()).check(RolloutShape(STEPS, ENVS, 4, 1))


def test_until_it_is_kept_a_rollout_is_made_again(
    used: tuple[Collector, list[Rollout]], policy: Policy, reader: PolicyReader
) -> None:
    """The same bits, as often as it is asked for; another policy starts from the same states."""
    collector, _ = used
    seq = collector.seq
    first, second = arrays_of(collect(collector, policy)), arrays_of(collect(collector, policy))
    assert_same(first, second)
    other = arrays_of(collect(collector, reader.initial()))
    np.testing.assert_array_equal(other["obs"][0], first["obs"][0])
    assert (other["action"] != first["action"]).any()
    assert_same(arrays_of(collect(collector, policy)), first)
    assert collector.seq == seq


def test_once_kept_the_environments_go_on(
    used: tuple[Collector, list[Rollout]], made: list[dict[str, np.ndarray]]
) -> None:
    """A rollout starts with the observations that the one before ended with, and draws other noise."""
    assert used[0].seq == ROLLOUTS
    for before, after in itertools.pairwise(made):
        np.testing.assert_array_equal(after["obs"][0], before["last_obs"])
        assert (after["action"] != before["action"]).all()


def test_the_same_slot_makes_the_same_rollouts(
    reader: PolicyReader, policy: Policy, made: list[dict[str, np.ndarray]]
) -> None:
    """Seed, slot, generation and seq decide: an actor on another machine makes the same bits."""
    fresh = make_collector(reader)
    for arrays in made[:3]:
        assert_same(arrays_of(collect(fresh, policy)), arrays)
        fresh.keep()


@pytest.mark.parametrize("holder", [SlotGeneration(slot=0, generation=2), SlotGeneration(slot=1, generation=0)])
def test_another_slot_or_generation_makes_other_rollouts(
    reader: PolicyReader, policy: Policy, made: list[dict[str, np.ndarray]], holder: SlotGeneration
) -> None:
    """No two slots, and no two holders of a slot, see the same starts or draw the same noise."""
    other = arrays_of(collect(make_collector(reader, holder), policy))
    assert (other["obs"][0] != made[0]["obs"][0]).any(axis=-1).all()
    assert (other["action"] != made[0]["action"]).all()


def mean_of(reader: PolicyReader, policy: Policy, obs: np.ndarray) -> Mean:
    """The policy mean in its parts at the observations [T, N, O] of a rollout, by the mathematics' own formula.

    Observations are whitened by moments of all that was seen up to them: the snapshot's, which weigh as the number of
    observations they are of, and those of the rollout's steps.
    """
    given = jax.device_get(policy.observations)
    seen = np.zeros(obs.shape)
    for t in range(len(obs)):
        values = obs[: t + 1].reshape(-1, obs.shape[-1]).astype(np.float64)
        total = given.count + len(values)
        mean = (given.count * given.mean + values.sum(axis=0)) / total
        second = (given.count * (given.variance + given.mean**2) + (values**2).sum(axis=0)) / total
        seen[t] = (obs[t] - mean) / np.sqrt(second - mean**2)
    representation = make_representation(SETTINGS)
    flat = jax.numpy.asarray(seen.reshape(-1, obs.shape[-1]), jax.numpy.float32)
    return jax.jit(partial(act, reader.networks, representation, normalise=False))(policy, flat)


def means_of(reader: PolicyReader, policy: Policy, made: list[dict[str, np.ndarray]]) -> Mean:
    """As `mean_of`, of rollouts end to end."""
    parts = [mean_of(reader, policy, arrays["obs"]) for arrays in made]
    joined_parts = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("features", "rkhs", "residual")
    )
    return Mean(*(jax.numpy.asarray(part) for part in joined_parts), parts[0].log_std)


def test_actions_are_drawn_from_the_policy(
    reader: PolicyReader, policy: Policy, made: list[dict[str, np.ndarray]]
) -> None:
    """`log_prob` is the diagonal Gaussian's density at the action, worked out by hand from the policy's mean."""
    action = joined(made, "action").reshape(-1, 1)
    mean = means_of(reader, policy, made)
    total, deviation = np.asarray(mean.total), np.exp(np.asarray(mean.log_std))
    # log N(a; m, s^2) = -((a - m) / s)^2 / 2 - log s - log(2 pi) / 2, summed over the action's one element
    standardised = (action - total) / deviation
    expected = (-0.5 * standardised**2 - np.log(deviation) - 0.5 * math.log(2 * math.pi)).sum(axis=-1)
    np.testing.assert_allclose(joined(made, "log_prob").ravel(), expected, rtol=1e-4, atol=1e-5)
    # 160 draws of a standard normal: mean within 4 / sqrt(160), standard deviation within 4 / sqrt(320) of 1
    assert abs(standardised.mean()) < 0.32
    assert abs(standardised.std() - 1.0) < 0.23
    # Every part of the policy counts: without the expansion the means are others.
    assert np.abs(np.asarray(mean.rkhs)).min() > 1e-4


@pytest.fixture(scope="module")
def branching(in_a_hurry: None, policy: Policy) -> list[dict[str, np.ndarray]]:
    """Three rollouts of a run whose gradient is estimated symmetrically, of the same slot and generation."""
    run = settings(**SETTINGS.model_dump() | {"rkhs": {"capacity": 6, "estimate": "symmetric"}})
    collector = Collector(run, HOLDER, PolicyReader(run))
    collector.compile()
    arrays = []
    for _ in range(3):
        arrays.append(arrays_of(collect(collector, policy)))
        collector.keep()
    return arrays


def test_a_branch_is_the_last_step_with_the_mirrored_action(
    environment: BatchedEnvironment,
    reader: PolicyReader,
    policy: Policy,
    branching: list[dict[str, np.ndarray]],
) -> None:
    """From the very state before it, a' = 2 m(o) - a; stepped by hand it gives the same reward, end and observation."""
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(SETTINGS.seed), HOLDER.slot), HOLDER.generation)
    state = environment.reset(jax.random.fold_in(key, RESET))
    for arrays in branching:
        for action in arrays["action"]:
            before = state
            state, _ = environment.step(state, jax.numpy.asarray(action))
        mean = np.asarray(mean_of(reader, policy, arrays["obs"]).total)[-ENVS:]
        np.testing.assert_allclose(arrays["mirror_action"], 2 * mean - arrays["action"][-1], rtol=1e-5, atol=1e-6)
        _, mirrored = environment.step(before, jax.numpy.asarray(arrays["mirror_action"]))
        np.testing.assert_allclose(arrays["mirror_reward"], mirrored.reward, rtol=1e-5)
        np.testing.assert_allclose(arrays["mirror_obs"], mirrored.next_obs, rtol=1e-4, atol=1e-5)
        np.testing.assert_array_equal(arrays["mirror_terminated"], mirrored.terminated)
        np.testing.assert_array_equal(arrays["mirror_truncated"], mirrored.truncated)
        # The branch is another life than the one that goes on.
        assert (arrays["mirror_obs"] != arrays["last_obs"]).any(axis=1).all()


def test_episodes_may_start_in_new_states(policy: Policy) -> None:
    """With `initial_states new` no two episodes of the run start alike, and the same place makes the same rollouts."""
    run = settings(**SETTINGS.model_dump() | {"initial_states": "new"})
    made = []
    for _ in range(2):
        collector = Collector(run, HOLDER, PolicyReader(run))
        collector.compile()
        sent = []
        for _ in range(4):
            sent.append(arrays_of(collect(collector, policy)))
            collector.keep()
        made.append(sent)
    for one, other in zip(*made, strict=True):
        assert_same(one, other)
    obs = np.concatenate([arrays["obs"] for arrays in made[0]])
    over = np.concatenate([arrays["terminated"] | arrays["truncated"] for arrays in made[0]])
    starts = np.concatenate([obs[0], obs[1:][over[:-1]]])
    # 4 environments x 20 steps, and no episode is longer than 7 steps: every environment starts at least three times.
    assert len(starts) >= 12
    assert len(np.unique(starts, axis=0)) == len(starts)


def test_a_branch_leaves_the_rollouts_as_they_are(
    made: list[dict[str, np.ndarray]], branching: list[dict[str, np.ndarray]]
) -> None:
    """Everything else of a rollout has the numbers of a run that does not branch."""
    for plain, branched in zip(made, branching, strict=False):
        for name in plain:
            if not name.startswith("mirror_"):
                np.testing.assert_allclose(branched[name], plain[name], rtol=1e-5, atol=1e-6, err_msg=name)


def test_rewards_and_ends_are_those_of_the_environments(
    environment: BatchedEnvironment, made: list[dict[str, np.ndarray]]
) -> None:
    """The recorded actions, stepped one by one from the slot's first states, give the recorded rollouts."""
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(SETTINGS.seed), HOLDER.slot), HOLDER.generation)
    state = environment.reset(jax.random.fold_in(key, RESET))
    assert RESET != COLLECT
    for arrays in made:
        cut = []
        for t in range(STEPS):
            np.testing.assert_allclose(arrays["obs"][t], state.obs, atol=1e-5)
            state, step = environment.step(state, jax.numpy.asarray(arrays["action"][t]))
            np.testing.assert_array_equal(arrays["reward"][t], step.reward)
            np.testing.assert_array_equal(arrays["terminated"][t], step.terminated)
            np.testing.assert_array_equal(arrays["truncated"][t], step.truncated)
            # In the order of time, then environment: the observation the time limit cut the episode at.
            cut += [np.asarray(step.next_obs)[n] for n in np.flatnonzero(arrays["truncated"][t])]
        np.testing.assert_allclose(arrays["last_obs"], state.obs, atol=1e-5)
        np.testing.assert_allclose(arrays["truncated_obs"], np.array(cut).reshape(-1, 4), atol=1e-5)
    assert joined(made, "truncated").any()
    assert joined(made, "terminated").any()


def episodes_of(made: list[dict[str, np.ndarray]]) -> Iterator[tuple[list[float], list[int]]]:
    """For each rollout returns and lengths of the episodes that end in it, counted by hand."""
    returns, lengths = [0.0] * ENVS, [0] * ENVS
    for arrays in made:
        ended_returns, ended_lengths = [], []
        for t in range(STEPS):
            for n in range(ENVS):
                returns[n] += float(arrays["reward"][t, n])
                lengths[n] += 1
                if arrays["terminated"][t, n] or arrays["truncated"][t, n]:
                    ended_returns.append(returns[n])
                    ended_lengths.append(lengths[n])
                    returns[n], lengths[n] = 0.0, 0
        yield ended_returns, ended_lengths


def test_episodes_are_accounted_for(made: list[dict[str, np.ndarray]]) -> None:
    """Each that ends is in the rollout it ends in, with its return and length over all rollouts it ran through."""
    total = 0
    for arrays, (returns, lengths) in zip(made, episodes_of(made), strict=True):
        assert arrays["episode_return"].tolist() == returns
        assert arrays["episode_length"].tolist() == lengths
        total += len(returns)
    # 4 environments x 40 steps, and no episode is longer than 7 steps
    assert total >= ENVS * (ROLLOUTS * STEPS // EPISODE)
    assert max(joined(made, "episode_length")) == EPISODE


def test_an_episode_is_cut_at_its_length(made: list[dict[str, np.ndarray]]) -> None:
    """It is truncated exactly then, and not when it ended by itself."""
    for arrays in made:
        over = arrays["terminated"] | arrays["truncated"]
        cut = arrays["truncated"][over]  # in the order of time, then environment, as the episodes
        assert (arrays["episode_length"][cut] == EPISODE).all()
        assert not (arrays["terminated"] & arrays["truncated"]).any()


def test_time_is_told_by_phase(used: tuple[Collector, list[Rollout]]) -> None:
    """Seconds inside the physics engine, and the rest."""
    for sent in used[1]:
        assert set(sent.timing) == {"collect", "physics"}
        assert sent.timing["physics"] > 0.0
        assert sent.timing["collect"] > 0.0


def test_diverged_simulations_are_counted(reader: PolicyReader, policy: Policy) -> None:
    """Two of four environments are put where MuJoCo gives up, and end at once; the next rollout is without them."""
    collector = make_collector(reader)
    arrays = collector.environments()
    positions = arrays["bodies/q"].copy()
    positions[[0, 2]] = 1e12
    collector.restore({**arrays, "bodies/q": positions}, 0)
    sent = collect(collector, policy)
    assert sent.diverged == 2
    np.testing.assert_array_equal(sent.terminated[0], [True, False, True, False])
    sent.check(RolloutShape(STEPS, ENVS, 4, 1))
    collector.keep()
    found = collector.diverged()
    assert found is not None
    assert (found.env, found.step, found.motion.steps) == (0, 0, 1)
    np.testing.assert_array_equal(found.motion.qpos, positions[:1])
    np.testing.assert_array_equal(found.motion.action, sent.action[:1, 0])
    assert collect(collector, policy).diverged == 0
    collector.keep()
    assert collector.diverged() is None


def test_the_engine_is_known(used: tuple[Collector, list[Rollout]]) -> None:
    """By the name that the run's summary uses."""
    assert used[0].physics == "native"


# -- snapshots ---------------------------------------------------------------------------------------------


def test_a_snapshot_of_other_settings_is_refused(reader: PolicyReader) -> None:
    """An array of another shape, one too many and one too few are errors, not a policy."""
    arrays = to_arrays(reader.initial())
    name = "parameters/log_std"
    assert name in arrays
    for wrong in (
        arrays | {name: np.zeros(2, np.float32)},
        arrays | {"stranger": np.zeros(1, np.float32)},
        {path: array for path, array in arrays.items() if path != name},
    ):
        with pytest.raises(CodecError, match="settings"):
            reader.read(wrong)


def test_the_template_is_the_policy_before_the_first_update(reader: PolicyReader) -> None:
    """h = 0 there: the mean is the residual layer's alone."""
    obs = np.ones((3, 4), np.float32)
    run = jax.jit(partial(act, reader.networks, make_representation(SETTINGS), normalise=True))
    mean = run(reader.initial(), obs)
    np.testing.assert_array_equal(mean.rkhs, np.zeros((3, 1)))
    np.testing.assert_array_equal(jax.jit(reader.mode)(reader.initial(), obs), mean.residual)


# -- evaluation --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def evaluated(reader: PolicyReader, policy: Policy) -> tuple[np.ndarray, np.ndarray]:
    return evaluate(SETTINGS, reader, policy, episodes=ENVS, threads=1)


def test_an_evaluation_is_so_many_episodes(evaluated: tuple[np.ndarray, np.ndarray]) -> None:
    """One return and one length for each; the pendulum is worth 1 a step while it stands."""
    returns, lengths = evaluated
    assert (returns.shape, lengths.shape) == ((ENVS,), (ENVS,))
    assert [array.dtype.name for array in evaluated] == ["float32", "int32"]
    assert ((lengths >= 1) & (lengths <= EPISODE)).all()
    np.testing.assert_array_equal(returns, lengths.astype(np.float32))


def test_an_evaluation_is_deterministic(
    environment: BatchedEnvironment, reader: PolicyReader, policy: Policy, evaluated: tuple[np.ndarray, np.ndarray]
) -> None:
    """Starts drawn with the run's seed alone and actions without noise: stepped by hand, the same first episodes."""
    state = environment.reset(jax.random.fold_in(jax.random.key(SETTINGS.seed), 0xE7A1))
    returns, lengths = np.zeros(ENVS, np.float32), np.zeros(ENVS, np.int32)
    mode = jax.jit(reader.mode)
    for _ in range(EPISODE):
        state, step = environment.step(state, mode(policy, state.obs))
        first = (lengths == 0) & (np.asarray(step.episode_length) > 0)
        returns = np.where(first, step.episode_return, returns)
        lengths = np.where(first, step.episode_length, lengths)
    np.testing.assert_array_equal(evaluated[0], returns)
    np.testing.assert_array_equal(evaluated[1], lengths)
    # The policy counts: with the mean alone some episodes are shorter than others, or than the limit.
    assert lengths.min() < EPISODE


def test_the_first_episode_is_kept(environment: BatchedEnvironment, reader: PolicyReader, policy: Policy) -> None:
    """Its joint positions before each step, to its end; and to play the same policy again gives the same again."""
    episodes = DeterministicEpisodes(SETTINGS, reader, ENVS, threads=1)
    first, again = episodes.play(policy), episodes.play(policy)
    for name in ("returns", "lengths", "qpos"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    state = environment.reset(jax.random.fold_in(jax.random.key(SETTINGS.seed), 0xE7A1))
    mode = jax.jit(reader.mode)
    expected = []
    for _ in range(first.lengths[0]):
        expected.append(np.asarray(state.bodies.q[0]))
        state, _ = environment.step(state, mode(policy, state.obs))
    np.testing.assert_array_equal(first.qpos, np.stack(expected))
    # one trajectory is kept by default: the whole first episode, worth 1 a step
    (motion,) = first.motions
    np.testing.assert_array_equal(motion.qpos, first.qpos)
    assert [part.shape for part in (motion.qvel, motion.action)] == [(first.lengths[0], 2), (first.lengths[0], 1)]
    assert motion.reward.sum() == first.returns[0]
    assert episodes.step_s == pytest.approx(0.04)  # the pendulum's 0.02 s, twice


def test_environments_go_on_elsewhere(
    reader: PolicyReader, policy: Policy, used: tuple[Collector, list[Rollout]]
) -> None:
    """Handed to another collector of the same slot, which makes the rollouts that would have followed, bit for bit."""
    collector = make_collector(reader)
    for _ in range(2):
        collector.collect(policy)
        collector.keep()
    heir = make_collector(reader)
    heir.collect(policy)  # not kept: of no consequence
    heir.restore(collector.environments(), collector.seq)
    for following in used[1][2:5]:
        assert_same(arrays_of(collect(heir, policy)), arrays_of(following))
        heir.keep()
    assert heir.seq == 5


def test_environments_of_other_settings_are_refused(reader: PolicyReader) -> None:
    """With the name of what does not fit; the collector's own stay."""
    collector = make_collector(reader)
    arrays = collector.environments()
    with pytest.raises(CodecError, match="obs is float32"):
        collector.restore({**arrays, "obs": arrays["obs"][:1]}, 3)
    assert collector.seq == 0
    assert_same(collector.environments(), arrays)
