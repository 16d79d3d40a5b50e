"""Small updates and what their equations say, written out in NumPy."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import numpy_reference as reference
from small_learners import Arrays, SmallLearner, changed, random_batch, small_learner

from common.config.settings import AlgorithmSettings, RkhsSettings, RunSettings
from common.maths import trees
from common.maths.state import Batch, LearnerState

GAMMA, LAMBDA, CLIP, VALUE_COEFFICIENT, ENTROPY_COEFFICIENT = 0.9, 0.8, 0.2, 0.5, 0.01
BANDWIDTH, ETA, MOMENTUM = 0.5, 0.1, 0.9
DPO_ALPHA, DPO_BETA, DRIFT_ALPHA, DRIFT_BETA = 2.0, 0.6, 1.0, 0.6
OLD_CENTRES, DRAWN, CAPACITY = 3, 8, 16


def one_gradient_step(name: str, estimate: str = "score", eta: float = ETA) -> SmallLearner:
    """A learner whose update is one pass over one minibatch, T = 3, E = 4 (two slots of two), O = 2, A = 2.

    With an epsilon far above any gradient, and a learning rate as large, Adam's first step is the gradient:
    lr g / (|g| + eps) = g / (1 + |g| / 1e4). 8 of the 12 transitions are drawn for the functional gradient,
    or all four pairs.
    """
    algorithm = AlgorithmSettings(
        gamma=GAMMA,
        gae_lambda=LAMBDA,
        epochs=1,
        minibatches=1,
        learning_rate=1e4,
        adam_eps=1e4,
        max_grad_norm=1e6,
        clip=CLIP,
        value_coefficient=VALUE_COEFFICIENT,
        entropy_coefficient=ENTROPY_COEFFICIENT,
        dpo_alpha=DPO_ALPHA,
        dpo_beta=DPO_BETA,
        hidden=(3, 3),
        bootstrap_at_truncation=name != "dpo",
    )
    rkhs = RkhsSettings(
        bandwidth=BANDWIDTH,
        eta=eta,
        momentum=MOMENTUM,
        clip=1.0,
        drift_alpha=DRIFT_ALPHA,
        drift_beta=DRIFT_BETA,
        estimate=estimate,
        samples=DRAWN if estimate == "score" else "batch",
        capacity=CAPACITY,
    )
    settings = RunSettings(
        learner=name, actors=2, num_envs=4, num_steps=3, total_steps=1200, algorithm=algorithm, rkhs=rkhs
    )
    return small_learner(settings, observation_size=2, action_size=2)


def in_the_middle(learner: SmallLearner, seed: int = 0) -> LearnerState:
    """A state in which nothing is at its start: every number moved, some centres in use, momentum under way."""
    rng = np.random.default_rng(seed)
    moved = {
        name: array + 0.5 * rng.standard_normal(array.shape)
        for name, array in trees.to_arrays(learner.start).items()
        if name.startswith("parameters/") or name in ("observations/mean", "returns/mean", "discounted")
    }
    if learner.start.expansion.capacity:
        for name, width in (("expansion/centres", 3), ("expansion/weights", 2), ("momentum/velocity", 2)):
            moved[name] = np.zeros((CAPACITY, width))
            moved[name][:OLD_CENTRES] = 0.5 * rng.standard_normal((OLD_CENTRES, width))
        moved["momentum/added"] = np.asarray(OLD_CENTRES)
    variances = {"observations/variance": np.array([0.5, 2.0]), "returns/variance": np.asarray(3.0)}
    counts = {"observations/count": np.asarray(40.0), "returns/count": np.asarray(30.0), "version": np.asarray(7)}
    return changed(learner.start, **moved, **variances, **counts)


def with_ratios(learner: SmallLearner, state: LearnerState, batch: Batch, log_ratio: np.ndarray) -> Batch:
    """The batch with log-probabilities from which the state's policy differs by the ratios given, [T, E]."""
    arrays = double(trees.to_arrays(state))
    log_prob, observation = np.zeros(log_ratio.shape), whitened(learner, arrays, batch).obs
    for index in np.ndindex(log_ratio.shape):
        mean, log_std = reference_policy(arrays, observation[index])
        log_prob[index] = reference.log_prob(mean, log_std, np.asarray(batch.action[index], np.float64))
    return replace(batch, log_prob=jnp.asarray(log_prob - log_ratio, jnp.float32))


def double(arrays: Arrays) -> Arrays:
    """The arrays in float64, parameters without their prefix."""
    return {name.removeprefix("parameters/"): array.astype(np.float64) for name, array in arrays.items()}


def whitened(learner: SmallLearner, before: Arrays, batch: Batch) -> Batch:
    """The batch with observations as the policy that acted saw them: whitened by moments that take in each step first.

    Every rollout (two environments) starts from the moments before; what was not acted on is whitened by its last.
    """
    raw = [batch.obs, batch.last_obs, batch.truncated_obs, batch.mirror_obs]
    steps, last, cut, mirrored = (np.array(x, np.float64) for x in raw)
    if learner.settings.algorithm.normalise_observations:
        for envs in (slice(0, 2), slice(2, 4)):
            moments = tuple(before[f"observations/{part}"] for part in ("mean", "variance", "count"))
            for at_t in (*(step[envs] for step in steps), last[envs]):
                moments = reference.moments(*moments, at_t)
                at_t[:] = (at_t - moments[0]) / np.sqrt(moments[1])
            for others in (cut[envs], mirrored[envs]):
                others[:] = (others - moments[0]) / np.sqrt(moments[1])
    return replace(batch, obs=steps, last_obs=last, truncated_obs=cut, mirror_obs=mirrored)


def reference_policy(arrays: Arrays, observation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """m(o) and log_std."""
    h = arrays["expansion/centres"], arrays["expansion/weights"]
    return reference.policy_mean(arrays, h, observation, BANDWIDTH), arrays["policy/log_std"]


@dataclass(frozen=True)
class Case:
    """One update: what went in, what came out, and what the loss is made of."""

    learner: SmallLearner
    batch: Batch
    before: Arrays
    after: Arrays
    metrics: dict[str, float]
    transitions: list[reference.Transition]

    def loss_parts(self, parameters: Arrays) -> dict[str, float]:
        """The loss and its parts at other parameters, the rest of the state as before."""
        arrays = {**self.before, **parameters}
        ppo = self.learner.settings.learner != "dpo"
        gains, value_losses, kls, clipped = [], [], [], []
        for transition in self.transitions:
            mean, log_std = reference_policy(arrays, transition.observation)
            ratio = np.exp(reference.log_prob(mean, log_std, transition.action) - transition.log_prob)
            if ppo:
                gains.append(reference.ppo_gain(ratio, transition.advantage, CLIP))
            else:
                drift = reference.drift(ratio, transition.advantage, DPO_ALPHA, DPO_BETA)
                gains.append(ratio * transition.advantage - drift)
            new_value = reference.value(arrays, transition.observation)
            value_losses.append(reference.value_loss(new_value, transition.value, transition.target, CLIP))
            kls.append(ratio - 1 - np.log(ratio))
            clipped.append(abs(ratio - 1) > CLIP)
        entropy = float(np.sum(arrays["policy/log_std"] + 0.5 * np.log(2 * np.pi * np.e)))
        policy_loss, value_loss = -np.mean(gains), np.mean(value_losses)
        return {
            "loss": policy_loss + VALUE_COEFFICIENT * value_loss - ENTROPY_COEFFICIENT * entropy,
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "kl": np.mean(kls),
            "clip_fraction": np.mean(clipped),
        }


def reference_moments(case_before: Arrays, batch: Batch) -> tuple[Arrays, np.ndarray]:
    """The moments and discounted returns after the batch, and the rewards [T, E] scaled by those up to each step."""
    reward, done = np.asarray(batch.reward, np.float64), np.asarray(batch.terminated | batch.truncated)
    # Two rollouts of two environments each, side by side.
    by_rollout = [np.stack([x[:, :2], x[:, 2:]]) for x in (reward, done)]
    carried, every = reference.discounted_returns(
        case_before["discounted"], np.asarray(batch.slot), np.asarray(batch.fresh), *by_rollout, GAMMA
    )
    expected = {"discounted": carried}
    observations = np.asarray(batch.obs, np.float64).reshape(-1, 2)
    scaled = np.zeros_like(reward)
    for name, values in (("observations", [observations]), ("returns", every.transpose(1, 0, 2).reshape(3, 4))):
        moments = tuple(case_before[f"{name}/{part}"] for part in ("mean", "variance", "count"))
        for t, at_t in enumerate(values):
            moments = reference.moments(*moments, at_t)
            scaled[t] = reward[t] / np.sqrt(moments[1]) if name == "returns" else 0.0
        expected |= {f"{name}/{part}": x for part, x in zip(("mean", "variance", "count"), moments, strict=True)}
    return expected, scaled


def reference_transitions(learner: SmallLearner, before: Arrays, batch: Batch) -> list[reference.Transition]:
    """Observations as they were seen, rewards scaled, advantages by the critic as it stood."""
    _, reward = reference_moments(before, batch)
    inputs = whitened(learner, before, batch)
    observation = inputs.obs
    value = np.array([[reference.value(before, o) for o in row] for row in observation])
    last_value = np.array([reference.value(before, o) for o in inputs.last_obs])
    cut_value = np.array([reference.value(before, o) for o in inputs.truncated_obs])
    if not learner.settings.algorithm.bootstrap_at_truncation:
        cut_value = np.zeros_like(cut_value)
    truncated = np.asarray(batch.truncated)
    next_value = np.where(truncated, cut_value, np.concatenate([value[1:], last_value[None]]))
    advantage = reference.generalised_advantage(
        reward, value, next_value, np.asarray(batch.terminated), truncated, GAMMA, LAMBDA
    )
    normalised = reference.normalised(advantage)
    return [
        reference.Transition(
            observation=observation[index],
            action=np.asarray(batch.action[index], np.float64),
            log_prob=float(batch.log_prob[index]),
            value=value[index],
            advantage=normalised[index],
            target=advantage[index] + value[index],
        )
        for index in np.ndindex(value.shape)
    ]


@functools.cache
def case(name: str, estimate: str = "score") -> Case:
    """An update from the middle of training, on a batch with ends of both kinds and ratios from 0.2 to 4."""
    learner = one_gradient_step(name, estimate)
    state = in_the_middle(learner)
    batch = random_batch(learner, seed=5)
    assert batch.terminated.any()
    assert batch.truncated.any()
    log_ratio = np.random.default_rng(1).uniform(np.log(0.2), np.log(4.0), (3, 4))
    batch = with_ratios(learner, state, batch, log_ratio)
    new, metrics = learner.step(state, batch)
    before = double(trees.to_arrays(state))
    return Case(
        learner,
        batch,
        before,
        double(trees.to_arrays(new)),
        {metric: float(value) for metric, value in metrics.items()},
        reference_transitions(learner, before, batch),
    )
