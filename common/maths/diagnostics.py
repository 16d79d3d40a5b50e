"""Metrics of an update: the change of the policy, the state of h, the variance of its gradient."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from common.kernels.kernel import RadialKernel
from common.maths import gaussians, policy, variance
from common.maths.functional import FunctionalStep, Metrics
from common.maths.objectives import normalised
from common.maths.policy import Mean
from common.maths.rkhs.representation import Function
from common.maths.samples import Pairs, Samples, probe_stride
from common.maths.state import LearnerState

MEASURED = "variance/measured"
"""1 where the other metrics of `variance/` were measured at this update, else they are 0 and mean nothing."""


@dataclass(frozen=True)
class Diagnostics:
    """The metrics of a run, taken on an evenly spread part of the batch."""

    step: FunctionalStep

    def __call__(self, old: LearnerState, new: LearnerState, batch: Samples, pairs: Pairs) -> Metrics:
        """Metrics by name, scalars.

        Args:
            batch: all B transitions in one axis.
            pairs: where there are any, the functional gradient was estimated from them.
        """
        probe = batch[:: probe_stride(batch.log_prob.shape[0])]
        after = self._mean(new, new.expansion, probe)
        unexplained = jnp.var(batch.target - batch.value) / (jnp.var(batch.target) + 1e-8)
        metrics = {
            "train/explained_variance": 1.0 - unexplained,
            "policy/std": jnp.mean(jnp.exp(after.log_std)),
            "policy/mean_rms": _rms(after.total),
            "policy/kl": _kl_from_acting(after, probe),
        }
        if new.expansion.capacity:
            before = self._mean(new, old.expansion, probe)
            metrics |= self._of_h(new, before, after)
            metrics |= self._of_variance(old, new, batch, pairs, before)
        return metrics

    def _mean(self, new: LearnerState, function: Function, at: Samples) -> Mean:
        """The mean with the new networks and this h."""
        parameters = new.parameters["policy"]
        return policy.evaluate(self.step.networks, self.step.representation, parameters, function, at.obs)

    def _of_h(self, new: LearnerState, before: Mean, after: Mean) -> Metrics:
        representation = self.step.representation
        h, mu = jnp.mean(jnp.square(after.rkhs)), jnp.mean(jnp.square(after.residual))
        metrics = {
            "rkhs/centres": representation.size(new.expansion, new.representation_state),
            "rkhs/centre_age": representation.age(new.representation_state, self.step.samples),
            "rkhs/norm": representation.norm(new.expansion),
            "rkhs/h_rms": jnp.sqrt(h),
            "rkhs/residual_rms": jnp.sqrt(mu),
            "rkhs/share": h / (h + mu + 1e-12),
            "rkhs/step_kl": jnp.mean(gaussians.kl_of_means(before.total, after.total, after.log_std)),
        }
        metrics |= {f"rkhs/{name}": value for name, value in representation.figures(new.representation_state).items()}
        count = after.features.shape[0]
        if isinstance(representation.kernel, RadialKernel) and count > 1:
            # Rows at a fixed distance would be the same environment at two times, close to one another.
            shuffled = after.features[np.random.default_rng(0).permutation(count)[: count - count % 2]]
            apart = jnp.sum(jnp.square(shuffled[: count // 2] - shuffled[count // 2 :]), axis=1)
            median = jnp.median(representation.kernel.distance(apart, jnp))
            metrics |= {
                "rkhs/median_distance": median,
                "rkhs/bandwidth_ratio": representation.kernel.bandwidth / (median + 1e-12),
            }
        return metrics

    def _of_variance(self, old: LearnerState, new: LearnerState, batch: Samples, pairs: Pairs, before: Mean) -> Metrics:
        """The variance metrics at every `variance_every`-th update; 0 at the others, and at no cost there."""
        every = self.step.settings.variance_every
        if not every:
            return {}

        def measure(_: None) -> Metrics:
            return self._variance_of_gradient(old, new, batch, pairs, before) | self._paper_variances(before, batch)

        def skip(_: None) -> Metrics:
            return {name: jnp.zeros((), jnp.float32) for name in jax.eval_shape(measure, None)}

        due = old.version % every == 0
        return jax.lax.cond(due, measure, skip, None) | {MEASURED: due}

    def _variance_of_gradient(
        self, old: LearnerState, new: LearnerState, batch: Samples, pairs: Pairs, before: Mean
    ) -> Metrics:
        """Equation 10 for one transition's gradient, and for the gradient that the settings take.

        That is the mean of n transitions or pairs, taken to be independent, in the functions of the representation.
        """
        step, representation = self.step, self.step.representation
        stride = probe_stride(batch.log_prob.shape[0])
        gain, advantage = step.gain(batch)[::stride], normalised(batch.advantage)[::stride]
        # Coefficients are over n, so that their sum is the gradient; here each stands for itself.
        single = step.samples * step.coefficients(before, batch[::stride], gain, advantage)
        mean, taken = before, single
        if count := pairs.taken.log_prob.shape[0]:
            weighed = jax.tree.map(lambda x: x[:: probe_stride(count)], step.weigh_pairs(pairs))
            mean = self._mean(new, old.expansion, weighed[0].taken)
            taken = step.samples * step.pair_coefficients(mean, *weighed)
        matrix = representation.gradient_gram(new.expansion, new.representation_state, mean.features, step.samples)
        return {
            "variance/gradient": variance.represented_variance(matrix, taken) / step.samples,
            "variance/one_transition": variance.gradient_variance(representation.kernel, before.features, single),
            "variance/linear_ratio": variance.linear_ratio(representation.kernel, before.features, single),
        }

    def _paper_variances(self, mean: Mean, batch: Samples) -> Metrics:
        """Equation 10 for the three gradients of Theorem 3.2; the quantities of Figures 8 to 10."""
        kernel, probe = self.step.representation.kernel, batch[:: probe_stride(batch.log_prob.shape[0])]
        gradients = variance.three_gradients(
            probe.action, mean.rkhs, mean.residual, mean.log_std, probe.value, probe.advantage
        )
        metrics = {
            f"variance/{name}": variance.gradient_variance(kernel, mean.features, coefficients)
            for name, coefficients in zip(("of_q", "of_a", "of_a_residual"), gradients, strict=True)
        }
        metrics |= {
            "variance/a_less_h": _rms(probe.action - mean.rkhs),
            "variance/mu": _rms(mean.residual),
            "variance/a_less_h_mu": _rms(probe.action - mean.total),
        }
        for name, quantity in (("q", probe.target), ("v", probe.value), ("a", probe.advantage)):
            metrics |= {f"variance/{name}_mean": jnp.mean(quantity), f"variance/{name}_std": jnp.std(quantity)}
        return metrics


def finiteness(state: LearnerState, losses: Metrics) -> Metrics:
    """For each part of the state whether all of it is finite, and whether every gradient norm on the way was."""
    parts = {
        "parameters": state.parameters,
        "optimiser": state.optimiser,
        "expansion": (state.expansion, state.representation_state),
        "observation moments": state.observations,
        "return moments": (state.returns, state.discounted),
        "gradient norm": losses["train/gradient_norm"],
    }
    if jax.tree.leaves(state.critic):
        parts["kernel critic"] = state.critic
    return {
        f"finite/{name}": jnp.all(
            jnp.stack([jnp.all(jnp.isfinite(leaf.astype(jnp.float32))) for leaf in jax.tree.leaves(part)])
        )
        for name, part in parts.items()
    }


def _kl_from_acting(mean: Mean, taken: Samples) -> Float[Array, ""]:
    """KL divergence of the policy from the one that acted, estimated from its actions by the mean of r - 1 - log r."""
    log_ratio = gaussians.log_prob(mean.total, mean.log_std, taken.action) - taken.log_prob
    return jnp.mean(jnp.expm1(log_ratio) - log_ratio)


def _rms(x: Array) -> Array:
    return jnp.sqrt(jnp.mean(jnp.square(x)))
