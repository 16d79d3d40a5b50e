"""One iteration of the learner, `state, batch -> state, metrics` (paper, Algorithm 1).

Advantages with the critic as it stands, epochs of minibatches on the networks, one step of the expansion,
then the running moments. Networks see observations standardised as the actors' policies did, by moments that take in
each step before it is seen; rewards are scaled likewise (PureJaxRL).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import optax
from jax import Array
from jaxtyping import Float, Int, Key

from common.config.settings import AlgorithmSettings, RunSettings
from common.learners import LEARNERS, Learner
from common.maths import gaussians, objectives, policy, returns, running
from common.maths.critic.kernel_critic import KernelCritic, NoCorrection, make_kernel_critic
from common.maths.diagnostics import Diagnostics, finiteness
from common.maths.functional import FunctionalStep, Metrics
from common.maths.networks import Networks, Parameters, within_bound
from common.maths.rkhs.make import make_representation
from common.maths.rkhs.representation import Function, Representation
from common.maths.samples import Pairs, Samples, flatten
from common.maths.state import Batch, LearnerState, make_optimiser


@dataclass(frozen=True)
class Update:
    """The update of one run, its settings bound. Call it under `jax.jit`."""

    networks: Networks
    learner: Learner
    algorithm: AlgorithmSettings
    optimiser: optax.GradientTransformation
    step: FunctionalStep
    critic: KernelCritic
    diagnostics: Diagnostics
    rows_on: jax.sharding.Sharding | None = None
    """Devices of the rows of minibatches, [minibatches, rows]; None for one device."""

    @property
    def representation(self) -> Representation[Any, Any]:
        return self.step.representation

    @property
    def objective(self) -> Literal["clip", "dpo"]:
        """The networks' objective: that of the settings, or the learner's own."""
        if self.algorithm.objective != "auto":
            return self.algorithm.objective
        return "dpo" if self.learner.objective == "dpo" else "clip"

    def __call__(self, state: LearnerState, batch: Batch) -> tuple[LearnerState, Metrics]:
        """The next state, and metrics as float32 scalars.

        `metrics["finite/<part>"]` is 1 where every number of that part of the next state is finite; the caller
        must not use a state of which one is 0.
        """
        shuffle_key, draw_key = jax.random.split(jax.random.fold_in(jax.random.wrap_key_data(state.key), state.version))
        return_moments, discounted, reward = self._scaled_rewards(state, batch)
        whitened = self._whitened(state, batch)
        by_step = self._samples(state, whitened, reward)
        samples = jax.tree.map(flatten, by_step)
        network_value = self._network_value(state, samples)
        parameters, optimiser, losses = self._train_networks(state, samples, network_value, shuffle_key)
        critic, critic_metrics = self.critic.refit(state.critic, parameters, by_step.obs, by_step.target)
        expansion, representation_state, rkhs_metrics = state.expansion, state.representation_state, Metrics()
        pairs = self._pairs(state, whitened, by_step, return_moments)
        if expansion.capacity:
            expansion, representation_state, rkhs_metrics = self.step(
                expansion, representation_state, parameters["policy"], samples, pairs, draw_key
            )
        observations = state.observations
        if self.algorithm.normalise_observations:
            observations = running.merge(observations, flatten(batch.obs))
        new = LearnerState(
            parameters=parameters,
            optimiser=optimiser,
            expansion=expansion,
            representation_state=representation_state,
            observations=observations,
            returns=return_moments,
            discounted=discounted,
            key=state.key,
            version=state.version + 1,
            critic=critic,
        )
        measured = self.diagnostics(state, new, samples, pairs) | finiteness(new, losses)
        metrics = losses | rkhs_metrics | critic_metrics | measured
        return new, {name: jnp.asarray(value, jnp.float32) for name, value in metrics.items()}

    def _scaled_rewards(self, state: LearnerState, batch: Batch) -> tuple[running.Moments, Array, Array]:
        """Rewards over the standard deviation of the discounted return up to their step, as [T, E]."""
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
        by_step = jnp.moveaxis(every_return, 1, 0).reshape(batch.reward.shape)
        moments, reward = running.merge_and_scale(state.returns, by_step, batch.reward)
        return moments, discounted, reward

    def _whitened(self, state: LearnerState, batch: Batch) -> Batch:
        """The batch with observations as its actors saw them: each rollout starts from the moments of the snapshot.

        What an actor did not act on is whitened by the moments at the rollout's end.
        """
        if not self.algorithm.normalise_observations:
            return batch
        rollouts = batch.slot.shape[0]

        def one_rollout(obs: Array, last_obs: Array, *not_acted_on: Array) -> tuple[Array, ...]:
            steps = jnp.concatenate([obs, last_obs[None]])
            moments, steps = running.merge_and_standardise(state.observations, steps)
            return steps[:-1], steps[-1], *(running.standardise(moments, x) for x in not_acted_on)

        together = (batch.obs, batch.last_obs, batch.truncated_obs, batch.mirror_obs)
        axes = (1, 0, 0, 0)  # where the rollouts lie side by side in each
        apart = [_split(x, axis, rollouts) for x, axis in zip(together, axes, strict=True)]
        whitened = jax.vmap(one_rollout, in_axes=axes, out_axes=axes)(*apart)
        obs, last_obs, truncated_obs, mirror_obs = (
            x.reshape(like.shape) for x, like in zip(whitened, together, strict=True)
        )
        return replace(batch, obs=obs, last_obs=last_obs, truncated_obs=truncated_obs, mirror_obs=mirror_obs)

    def _samples(self, state: LearnerState, batch: Batch, reward: Float[Array, "T E"]) -> Samples:
        """Values and advantages under the critic as it stands; all arrays [T, E, ...].

        Args:
            batch: its observations whitened.
            reward: scaled.
        """
        value = self._value(state, batch.obs)
        last_value = self._value(state, batch.last_obs)
        next_value = jnp.concatenate([value[1:], last_value[None]])
        truncated_value = jnp.zeros_like(value[:1])
        if self.algorithm.bootstrap_at_truncation:
            # An environment is truncated at most once a rollout: settings keep T within an episode.
            truncated_value = self._value(state, batch.truncated_obs)[None]
        advantage = returns.generalised_advantage(
            reward,
            value,
            jnp.where(batch.truncated, truncated_value, next_value),
            batch.terminated,
            batch.truncated,
            gamma=self.algorithm.gamma,
            lambda_=self.algorithm.gae_lambda,
        )
        return Samples(batch.obs, batch.action, batch.log_prob, value, advantage)

    def _pairs(self, state: LearnerState, batch: Batch, samples: Samples, return_moments: running.Moments) -> Pairs:
        """The last step of the rollouts, whose advantage is that of one step, and what its mirror image gave.

        Args:
            batch: its observations whitened.
            samples: of the batch, [T, E, ...].
        """
        reward = batch.mirror_reward
        taken: Samples = jax.tree.map(lambda x: x[-1, : reward.shape[0]], samples)
        if self.algorithm.normalise_rewards:
            reward = running.scale(return_moments, reward)
        next_value = self._value(state, batch.mirror_obs)
        if not self.algorithm.bootstrap_at_truncation:
            next_value = jnp.where(batch.mirror_truncated, 0.0, next_value)
        (advantage,) = returns.generalised_advantage(
            reward[None],
            taken.value[None],
            next_value[None],
            batch.mirror_terminated[None],
            batch.mirror_truncated[None],
            gamma=self.algorithm.gamma,
            lambda_=self.algorithm.gae_lambda,
        )
        # A Gaussian is as dense at the mirrored action as at the one taken.
        return Pairs(taken, Samples(taken.obs, batch.mirror_action, taken.log_prob, taken.value, advantage))

    def _value(self, state: LearnerState, obs: Float[Array, "*batch O"]) -> Float[Array, "*batch"]:
        """V, with the correction g of its network where the run has one."""
        flat = obs.reshape(-1, obs.shape[-1])
        return self.critic.value(state.critic, state.parameters, flat).reshape(obs.shape[:-1])

    def _network_value(self, state: LearnerState, samples: Samples) -> Float[Array, "B"]:
        """V without its correction, at all transitions in one axis."""
        if isinstance(state.critic, NoCorrection):
            return samples.value  # the same array, so that a minibatch takes its rows once
        return self.networks.value(state.parameters["critic"], samples.obs)

    def _train_networks(
        self, state: LearnerState, samples: Samples, network_value: Float[Array, "B"], key: Key[Array, ""]
    ) -> tuple[Parameters, optax.OptState, Metrics]:
        """Epochs of minibatches; h and g are constant here, gradients flow through h into the features.

        Args:
            network_value: of the critic's network alone, which learns the whole target: g is fitted to what is left.
        """
        count, parts = samples.log_prob.shape[0], self.algorithm.minibatches

        def minibatch(
            carry: tuple[Parameters, optax.OptState], rows: Int[Array, "b"]
        ) -> tuple[tuple[Parameters, optax.OptState], Metrics]:
            parameters, optimiser = carry
            gradient, metrics = jax.grad(self._loss, has_aux=True)(
                parameters, state.expansion, samples[rows], network_value[rows]
            )
            updates, optimiser = self.optimiser.update(gradient, optimiser, parameters)
            # Beyond 1.8e19 the square of the norm overflows, and clipping by an infinite norm makes the step zero.
            metrics["gradient_norm"] = optax.tree.norm(gradient)
            parameters = within_bound(optax.apply_updates(parameters, updates), self.algorithm.max_log_std)
            return (parameters, optimiser), metrics

        # One sort of random words; jax.random.permutation sorts twice, which shows in the time of an update.
        words = jax.random.bits(key, (self.algorithm.epochs, count))
        rows = jnp.argsort(words, axis=1).reshape(-1, count // parts)
        if self.rows_on is not None:
            # Everything else lies on every device: gradients of parts of a minibatch are all that is exchanged.
            rows = jax.lax.with_sharding_constraint(rows, self.rows_on)
        (parameters, optimiser), metrics = jax.lax.scan(minibatch, (state.parameters, state.optimiser), rows)
        return parameters, optimiser, {f"train/{name}": jnp.mean(values) for name, values in metrics.items()}

    def _loss(
        self, parameters: Parameters, function: Function, samples: Samples, network_value: Float[Array, "b"]
    ) -> tuple[Float[Array, ""], Metrics]:
        """The scalar that is descended on one minibatch."""
        settings = self.algorithm
        mean = policy.evaluate(self.networks, self.representation, parameters["policy"], function, samples.obs)
        rkhs = mean.rkhs if self.step.settings.feature_gradient else jax.lax.stop_gradient(mean.rkhs)
        total = rkhs + mean.residual
        if self.learner.objective == "none":
            total = jax.lax.stop_gradient(total)
        log_ratio = gaussians.log_prob(total, mean.log_std, samples.action) - samples.log_prob
        ratio = jnp.exp(log_ratio)
        advantage = objectives.normalised(samples.advantage)
        if self.objective == "dpo":
            gain = objectives.drifted(log_ratio, advantage, alpha=settings.dpo_alpha, beta=settings.dpo_beta)
        else:
            gain = objectives.clipped(ratio, advantage, clip=settings.clip)
        value_loss = objectives.clipped_value_loss(
            self.networks.value(parameters["critic"], samples.obs),
            network_value,
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


def _split(x: Array, axis: int, parts: int) -> Array:
    """One axis as two, the first of them of that many parts."""
    return x.reshape(*x.shape[:axis], parts, x.shape[axis] // parts, *x.shape[axis + 1 :])


def make_update(settings: RunSettings, networks: Networks) -> Update:
    """The update of a run."""
    learner = LEARNERS[settings.learner]
    step = FunctionalStep(networks, make_representation(settings), settings.rkhs, learner.target, settings.samples)
    return Update(
        networks=networks,
        learner=learner,
        algorithm=settings.algorithm,
        optimiser=make_optimiser(settings.algorithm),
        step=step,
        critic=make_kernel_critic(settings, networks),
        diagnostics=Diagnostics(step),
    )
