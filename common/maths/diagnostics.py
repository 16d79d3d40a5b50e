"""What an update did to the policy, as metrics."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from common.kernels.kernel import RadialKernel
from common.maths import gaussians, policy, variance
from common.maths.functional import FunctionalStep, Metrics
from common.maths.objectives import normalised
from common.maths.policy import Mean
from common.maths.rkhs.representation import Function
from common.maths.samples import Samples, probe_stride
from common.maths.state import LearnerState

MEASURED = "variance/measured"
"""1 where the other metrics of `variance/` were measured at this update, else they are 0 and mean nothing."""


@dataclass(frozen=True)
class Diagnostics:
    """The metrics of a run, taken on an evenly spread part of the batch."""

    step: FunctionalStep

    def __call__(self, old: LearnerState, new: LearnerState, batch: Samples) -> Metrics:
        """Metrics by name, scalars.

        Args:
            batch: all B transitions in one axis.
        """
        probe = batch[:: probe_stride(batch.log_prob.shape[0])]

        def at(function: Function) -> Mean:
            parameters = new.parameters["policy"]
            return policy.evaluate(self.step.networks, self.step.representation, parameters, function, probe.obs)

        after = at(new.expansion)
        unexplained = jnp.var(batch.target - batch.value) / (jnp.var(batch.target) + 1e-8)
        metrics = {
            "train/explained_variance": 1.0 - unexplained,
            "policy/std": jnp.mean(jnp.exp(after.log_std)),
            "policy/mean_rms": _rms(after.total),
        }
        if new.expansion.capacity:
            before = at(old.expansion)
            metrics |= self._of_h(new, before, after)
            metrics |= self._of_variance(old, batch, before, probe)
        return metrics

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
        half = after.features.shape[0] // 2
        if isinstance(representation.kernel, RadialKernel) and half:
            apart = jnp.sum(jnp.square(after.features[:half] - after.features[half : 2 * half]), axis=1)
            median = jnp.median(representation.kernel.distance(apart, jnp))
            metrics |= {
                "rkhs/median_distance": median,
                "rkhs/bandwidth_ratio": representation.kernel.bandwidth / (median + 1e-12),
            }
        return metrics

    def _of_variance(self, old: LearnerState, batch: Samples, before: Mean, probe: Samples) -> Metrics:
        """The laboratory's figures, at every `variance_every`-th update; 0 at the others, and at no cost there."""
        every = self.step.settings.variance_every
        if not every:
            return {}
        stride = probe_stride(batch.log_prob.shape[0])
        gain, advantage = self.step.gain(batch)[::stride], normalised(batch.advantage)[::stride]

        def measure(_: None) -> Metrics:
            return self._gradient_variance_metrics(before, probe, gain, advantage)

        def skip(_: None) -> Metrics:
            return {name: jnp.zeros((), jnp.float32) for name in jax.eval_shape(measure, None)}

        due = old.version % every == 0
        return jax.lax.cond(due, measure, skip, None) | {MEASURED: due}

    def _gradient_variance_metrics(
        self, mean: Mean, probe: Samples, gain: Float[Array, "G"], advantage: Float[Array, "G"]
    ) -> Metrics:
        """Equation 10 for the gradient as taken and for those of Theorem 3.2; the quantities of Figures 8 to 10."""
        kernel = self.step.representation.kernel
        taken = self.step.samples * self.step.coefficients(mean, probe, gain, advantage)
        with_q, with_a, with_residual = variance.three_gradients(
            probe.action, mean.rkhs, mean.residual, mean.log_std, probe.value, probe.advantage
        )

        def of(coefficients: Float[Array, "G A"]) -> Float[Array, ""]:
            return variance.gradient_variance(kernel, mean.features, coefficients)

        metrics = {
            "variance/gradient": of(taken),
            "variance/linear_ratio": variance.linear_ratio(kernel, mean.features, taken),
            "variance/of_q": of(with_q),
            "variance/of_a": of(with_a),
            "variance/of_a_residual": of(with_residual),
            "variance/a_less_h": _rms(probe.action - mean.rkhs),
            "variance/mu": _rms(mean.residual),
            "variance/a_less_h_mu": _rms(probe.action - mean.total),
        }
        for name, quantity in (("q", probe.target), ("v", probe.value), ("a", probe.advantage)):
            metrics |= {f"variance/{name}_mean": jnp.mean(quantity), f"variance/{name}_std": jnp.std(quantity)}
        return metrics


def finiteness(state: LearnerState) -> Metrics:
    """For each part of the state, whether all of it is finite."""
    parts = {
        "parameters": state.parameters,
        "optimiser": state.optimiser,
        "expansion": (state.expansion, state.representation_state),
        "observation moments": state.observations,
        "return moments": (state.returns, state.discounted),
    }
    if jax.tree.leaves(state.critic):
        parts["kernel critic"] = state.critic
    return {
        f"finite/{name}": jnp.all(
            jnp.stack([jnp.all(jnp.isfinite(leaf.astype(jnp.float32))) for leaf in jax.tree.leaves(part)])
        )
        for name, part in parts.items()
    }


def _rms(x: Array) -> Array:
    return jnp.sqrt(jnp.mean(jnp.square(x)))
