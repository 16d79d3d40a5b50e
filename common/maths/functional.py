"""The functional gradient and the step along it (paper, equations 3, 6, 7 and 8 with section B.1).

One iteration: n transitions give alpha, the representation takes sum_k alpha_k K(z_k, .) into its moving average v, a
rule says how far to go, and h moves along v.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key

from common.learners import Target
from common.maths import gaussians, objectives, policy
from common.maths.expansion import Momentum
from common.maths.networks import Networks, Parameters
from common.maths.policy import Mean
from common.maths.rkhs.representation import Function, Representation
from common.maths.samples import Samples, probe_stride, spread_rows
from common.settings_rkhs import RkhsSettings

Metrics = dict[str, Array]

_LEAST_KL = 1e-20  # keeps a step without direction from being divided by zero


@dataclass(frozen=True)
class FunctionalStep:
    """The functional step of a run, its settings bound. n is `samples`."""

    networks: Networks
    representation: Representation[Any, Any]
    settings: RkhsSettings
    target: Target
    samples: int

    def __call__(
        self,
        function: Function,
        momentum: Momentum,
        parameters: Parameters,
        batch: Samples,
        key: Key[Array, ""],
    ) -> tuple[Function, Momentum, Metrics]:
        """The next h and v, for the networks as they are after their training.

        Args:
            parameters: of the policy.
            batch: all B transitions in one axis.
        """
        representation, settings, count = self.representation, self.settings, batch.log_prob.shape[0]

        def mean_at(observation: Array) -> Mean:
            return policy.evaluate(self.networks, representation, parameters, function, observation)

        gain = self.gain(batch)
        drawn, advantage = batch, objectives.normalised(batch.advantage)
        if self.samples < count:
            rows = jax.random.choice(key, count, (self.samples,), replace=False)
            drawn, gain, advantage = batch[rows], gain[rows], advantage[rows]
        mean = mean_at(drawn.observation)
        alpha = self.coefficients(mean, drawn, gain, advantage)
        function, momentum = representation.average(
            function,
            momentum,
            mean.features,
            alpha,
            lambda wanted: mean_at(batch.observation[spread_rows(count, wanted)]).features,
            decay=settings.momentum,
        )
        scale = self._scale(function, momentum, mean_at, batch, mean.log_std)
        function = representation.apply(function, momentum, scale, shrinkage=settings.shrinkage)
        return (
            function,
            momentum,
            {"rkhs/alpha": jnp.sqrt(jnp.sum(jnp.square(alpha))), "rkhs/scale": jnp.asarray(scale)},
        )

    def gain(self, batch: Samples) -> Float[Array, "B"]:
        """G: the lambda-return A + V as it is, or the advantage normalised over the batch."""
        return batch.target if self.target == "Q" else objectives.normalised(batch.advantage)

    def coefficients(
        self, mean: Mean, drawn: Samples, gain: Float[Array, "n"], advantage: Float[Array, "n"]
    ) -> Float[Array, "n A"]:
        """alpha_k = eta/n rho_k Sigma^-1 (a_k - m(o_k)) (G_k - D_k), rho = min(r, clip(r)).

        D is DPO's drift of the normalised advantage, whatever G is. A step size that is found by a rule makes eta 1.
        """
        settings = self.settings
        log_ratio = gaussians.log_prob(mean.total, mean.log_std, drawn.action) - drawn.log_prob
        ratio = jnp.exp(log_ratio)
        held = jnp.minimum(ratio, jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip))
        gain = gain - objectives.drift(log_ratio, advantage, alpha=settings.drift_alpha, beta=settings.drift_beta)
        score = gaussians.score(mean.total, mean.log_std, drawn.action)
        eta = settings.eta if settings.step == "fixed" else 1.0
        return (eta / self.samples) * (held * gain)[:, None] * score

    def _scale(
        self,
        function: Function,
        momentum: Momentum,
        mean_at: Callable[[Array], Mean],
        batch: Samples,
        log_std: Float[Array, "A"],
    ) -> float | Float[Array, ""]:
        """How far to go along v: 1, or what makes the mean KL of the step its target.

        Only the mean moves, and it is linear in the step: KL(s v) = s^2 KL(v), so the size has a closed form.
        """
        if self.settings.step == "fixed":
            return 1.0
        features = mean_at(batch.observation[:: probe_stride(batch.log_prob.shape[0])]).features
        v = self.representation.velocity(function, momentum, features)
        kl = jnp.mean(gaussians.kl_of_means(v, jnp.zeros_like(v), log_std))
        return jnp.sqrt(self.settings.kl_target / jnp.maximum(kl, _LEAST_KL))


def symmetric(
    score: Float[Array, "n A"], gain: Float[Array, "n"], mirrored_gain: Float[Array, "n"]
) -> Float[Array, "n A"]:
    """Sigma^-1 (a - m) (G(a) - G(2m - a)) / 2: the symmetric estimate (Paternain et al. 2020).

    The mean of the estimates at an action and at its mirror image in the policy's mean, whose score is -Sigma^-1 (a -
    m). Whatever of G is the same at both cancels, so that no baseline is needed: for the Q of Lemma 3.1 the variance
    drops from 2 c^2 + Sigma^-1 (c h + d)^2 to 2 c^2. Needs the gain of both actions from the same state.
    """
    return 0.5 * (gain - mirrored_gain)[:, None] * score
