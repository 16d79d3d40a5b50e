"""One iteration of the learner, `state, batch -> state, metrics` (paper, Algorithm 1).

Advantages with the critic as it stands, epochs of minibatches on the networks, one step of the expansion,
then the running moments. Networks see observations standardised by the moments the actors acted with.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jaxtyping import Float, Int, Key

from common.learners import LEARNERS, Learner
from common.maths import expansion as expansions
from common.maths import gaussians, objectives, policy, returns, running
from common.maths.expansion import Expansion, Momentum
from common.maths.kernels import Kernel, make_kernel
from common.maths.networks import Networks, Parameters
from common.maths.state import Batch, LearnerState, make_optimiser
from common.settings import AlgorithmSettings, RkhsSettings, RunSettings

Metrics = dict[str, Array]

PROBE = 1024
"""Transitions on which the metrics that cost a forward pass are taken."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Samples:
    """The transitions of a batch as the networks train on them, in any order."""

    observation: Float[Array, "*batch O"]
    action: Float[Array, "*batch A"]
    log_prob: Float[Array, "*batch"]
    value: Float[Array, "*batch"]
    advantage: Float[Array, "*batch"]

    @property
    def target(self) -> Float[Array, "*batch"]:
        """The lambda-return A + V, which the critic learns."""
        return self.advantage + self.value


@dataclass(frozen=True)
class Update:
    """The update of one run, its settings bound. Call it under `jax.jit`."""

    networks: Networks
    learner: Learner
    kernel: Kernel
    algorithm: AlgorithmSettings
    rkhs: RkhsSettings
    optimiser: optax.GradientTransformation

    def __call__(self, state: LearnerState, batch: Batch) -> tuple[LearnerState, Metrics]:
        """The next state, and metrics as float32 scalars.

        `metrics["finite/<part>"]` is 1 where every number of that part of the next state is finite; the caller
        must not use a state of which one is 0.
        """
        shuffle_key, draw_key = jax.random.split(jax.random.fold_in(jax.random.wrap_key_data(state.key), state.version))
        return_moments, discounted, reward = self._scaled_rewards(state, batch)
        samples = self._samples(state, batch, reward)
        parameters, optimiser, losses = self._train_networks(state, samples, shuffle_key)
        expansion, momentum, rkhs_metrics = self._step_expansion(state, parameters["policy"], samples, draw_key)
        observations = state.observations
        if self.algorithm.normalise_observations:
            observations = running.merge(observations, _flat(batch.observation))
        new = LearnerState(
            parameters=parameters,
            optimiser=optimiser,
            expansion=expansion,
            momentum=momentum,
            observations=observations,
            returns=return_moments,
            discounted=discounted,
            key=state.key,
            version=state.version + 1,
        )
        metrics = losses | rkhs_metrics | self._probe(state, new, samples) | _finiteness(new)
        return new, {name: jnp.asarray(value, jnp.float32) for name, value in metrics.items()}

    def _scaled_rewards(self, state: LearnerState, batch: Batch) -> tuple[running.Moments, Array, Array]:
        """Rewards over the standard deviation of the discounted return, as [T, E]."""
        if not self.algorithm.normalise_rewards:
            return state.returns, state.discounted, batch.reward
        rollouts = batch.slot.shape[0]

        def by_rollout(x: Array) -> Array:
            return jnp.moveaxis(x.reshape(x.shape[0], rollouts, -1), 1, 0)

        discounted, every_return = returns.discounted_returns(
            state.discounted,
            batch.slot,
            batch.fresh,
            by_rollout(batch.reward),
            by_rollout(batch.terminated | batch.truncated),
            gamma=self.algorithm.gamma,
        )
        moments = running.merge(state.returns, every_return.reshape(-1))
        return moments, discounted, running.scale(moments, batch.reward)

    def _samples(self, state: LearnerState, batch: Batch, reward: Float[Array, "T E"]) -> Samples:
        """Values and advantages under the critic as it stands; all arrays [T, E, ...]."""

        def whiten(observation: Array) -> Array:
            if self.algorithm.normalise_observations:
                return running.standardise(state.observations, observation)
            return observation

        def value_of(observation: Array) -> Array:
            flat = observation.reshape(-1, observation.shape[-1])
            return self.networks.value(state.parameters["critic"], flat).reshape(observation.shape[:-1])

        observation = whiten(batch.observation)
        value = value_of(observation)
        next_value = jnp.concatenate([value[1:], value_of(whiten(batch.last_observation))[None]])
        cut_value = jnp.zeros_like(value[:1])
        if self.algorithm.bootstrap_at_truncation:
            # An environment is truncated at most once a rollout: settings keep T within an episode.
            cut_value = value_of(whiten(batch.cut_observation))[None]
        advantage = returns.generalised_advantage(
            reward,
            value,
            jnp.where(batch.truncated, cut_value, next_value),
            batch.terminated,
            batch.truncated,
            gamma=self.algorithm.gamma,
            lambda_=self.algorithm.gae_lambda,
        )
        return Samples(observation, batch.action, batch.log_prob, value, advantage)

    def _train_networks(
        self, state: LearnerState, samples: Samples, key: Key[Array, ""]
    ) -> tuple[Parameters, optax.OptState, Metrics]:
        """Epochs of minibatches; h is constant here, gradients flow through it into the features."""
        flat = jax.tree.map(_flat, samples)
        count, parts = flat.log_prob.shape[0], self.algorithm.minibatches

        def minibatch(
            carry: tuple[Parameters, optax.OptState], rows: Int[Array, "b"]
        ) -> tuple[tuple[Parameters, optax.OptState], Metrics]:
            parameters, optimiser = carry
            chosen = jax.tree.map(lambda x: x[rows], flat)
            gradient, metrics = jax.grad(self._loss, has_aux=True)(parameters, state.expansion, chosen)
            updates, optimiser = self.optimiser.update(gradient, optimiser, parameters)
            metrics["gradient_norm"] = optax.tree.norm(gradient)
            return (optax.apply_updates(parameters, updates), optimiser), metrics

        # One sort of random words; jax.random.permutation sorts twice, which shows in the time of an update.
        words = jax.random.bits(key, (self.algorithm.epochs, count))
        rows = jnp.argsort(words, axis=1).reshape(-1, count // parts)
        (parameters, optimiser), metrics = jax.lax.scan(minibatch, (state.parameters, state.optimiser), rows)
        return parameters, optimiser, {f"train/{name}": jnp.mean(values) for name, values in metrics.items()}

    def _loss(self, parameters: Parameters, expansion: Expansion, samples: Samples) -> tuple[Float[Array, ""], Metrics]:
        """The scalar that is descended on one minibatch."""
        settings = self.algorithm
        mean = policy.evaluate(self.networks, self.kernel, parameters["policy"], expansion, samples.observation)
        log_ratio = gaussians.log_prob(mean.total, mean.log_std, samples.action) - samples.log_prob
        ratio = jnp.exp(log_ratio)
        advantage = objectives.normalised(samples.advantage)
        if self.learner.objective == "ppo":
            gain = objectives.clipped(ratio, advantage, clip=settings.clip)
        else:
            gain = objectives.drifted(log_ratio, advantage, alpha=settings.dpo_alpha, beta=settings.dpo_beta)
        value_loss = objectives.clipped_value_loss(
            self.networks.value(parameters["critic"], samples.observation),
            samples.value,
            samples.target,
            clip=settings.clip,
        )
        entropy = gaussians.entropy(mean.log_std)
        policy_loss = -jnp.mean(gain)
        loss = policy_loss + settings.value_coefficient * value_loss - settings.entropy_coefficient * entropy
        return loss, {
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "kl": jnp.mean(ratio - 1.0 - log_ratio),
            "clip_fraction": jnp.mean(jnp.abs(ratio - 1.0) > settings.clip, dtype=jnp.float32),
        }

    def _step_expansion(
        self, state: LearnerState, parameters: Parameters, samples: Samples, key: Key[Array, ""]
    ) -> tuple[Expansion, Momentum, Metrics]:
        """alpha_k = eta / n * rho_k * Sigma^-1 (a_k - m(o_k)) * (A_k - D_k) at n transitions drawn uniformly.

        Equation 8 with the ratio, its clip and the drift of section B.1; A is normalised over the batch.
        """
        expansion, momentum = state.expansion, state.momentum
        if not expansion.capacity:
            return expansion, momentum, {}
        settings = self.rkhs
        flat = jax.tree.map(_flat, samples)
        rows = jax.random.choice(key, flat.log_prob.shape[0], (settings.samples,), replace=False)
        advantage = objectives.normalised(flat.advantage)[rows]
        observation, action, log_prob = flat.observation[rows], flat.action[rows], flat.log_prob[rows]
        mean = policy.evaluate(self.networks, self.kernel, parameters, expansion, observation)
        log_ratio = gaussians.log_prob(mean.total, mean.log_std, action) - log_prob
        ratio = jnp.exp(log_ratio)
        held = jnp.minimum(ratio, jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip))
        gain = advantage - objectives.drift(log_ratio, advantage, alpha=settings.drift_alpha, beta=settings.drift_beta)
        score = gaussians.score(mean.total, mean.log_std, action)
        alpha = (settings.eta / settings.samples) * (held * gain)[:, None] * score
        expansion, momentum = expansions.step(expansion, momentum, mean.features, alpha, decay=settings.momentum)
        return (
            expansion,
            momentum,
            {
                "rkhs/centres": expansions.size(expansion, momentum),
                "rkhs/alpha": jnp.sqrt(jnp.sum(jnp.square(alpha))),
            },
        )

    def _probe(self, old: LearnerState, new: LearnerState, samples: Samples) -> Metrics:
        """What the update did to the policy, on an evenly spread part of the batch."""
        flat = jax.tree.map(_flat, samples)
        stride = max(1, flat.log_prob.shape[0] // PROBE)
        observation = flat.observation[::stride]
        parameters = new.parameters["policy"]

        def at(expansion: Expansion) -> policy.Mean:
            return policy.evaluate(self.networks, self.kernel, parameters, expansion, observation)

        after = at(new.expansion)
        unexplained = jnp.var(flat.target - flat.value) / (jnp.var(flat.target) + 1e-8)
        metrics = {
            "train/explained_variance": 1.0 - unexplained,
            "policy/std": jnp.mean(jnp.exp(after.log_std)),
            "policy/mean_rms": _rms(after.total),
        }
        if new.expansion.capacity:
            before = at(old.expansion)
            metrics |= {
                "rkhs/h_rms": _rms(after.rkhs),
                "rkhs/residual_rms": _rms(after.residual),
                "rkhs/step_kl": jnp.mean(gaussians.kl_of_means(before.total, after.total, after.log_std)),
            }
        return metrics


def make_update(settings: RunSettings, networks: Networks) -> Update:
    """The update of a run."""
    return Update(
        networks=networks,
        learner=LEARNERS[settings.learner],
        kernel=make_kernel(settings.rkhs.kernel, settings.rkhs.bandwidth),
        algorithm=settings.algorithm,
        rkhs=settings.rkhs,
        optimiser=make_optimiser(settings.algorithm),
    )


def _flat(x: Array) -> Array:
    """[T, E, ...] as [T * E, ...]."""
    return x.reshape((-1, *x.shape[2:]))


def _rms(x: Array) -> Array:
    return jnp.sqrt(jnp.mean(jnp.square(x)))


def _finiteness(state: LearnerState) -> Metrics:
    """For each part of the state, whether all of it is finite."""
    parts = {
        "parameters": state.parameters,
        "optimiser": state.optimiser,
        "expansion": (state.expansion, state.momentum),
        "observation moments": state.observations,
        "return moments": (state.returns, state.discounted),
    }
    return {
        f"finite/{name}": jnp.all(
            jnp.stack([jnp.all(jnp.isfinite(leaf.astype(jnp.float32))) for leaf in jax.tree.leaves(part)])
        )
        for name, part in parts.items()
    }
