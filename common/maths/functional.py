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

from common.config.rkhs import RkhsSettings
from common.learners import Target
from common.maths import gaussians, objectives, policy
from common.maths.agreement import squared_cosine
from common.maths.expansion import RepresentationState
from common.maths.networks import Networks, Parameters
from common.maths.policy import Mean
from common.maths.rkhs.representation import Function, Representation
from common.maths.samples import Pairs, Samples, evenly_spread_rows, probe_stride
from common.maths.trust_region import TrustRegion

Metrics = dict[str, Array]


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
        state: RepresentationState,
        parameters: Parameters,
        batch: Samples,
        pairs: Pairs,
        key: Key[Array, ""],
    ) -> tuple[Function, RepresentationState, Metrics]:
        """The next h and v, for the networks as they are after their training.

        Args:
            parameters: of the policy.
            batch: all B transitions in one axis.
            pairs: where there are any, the gradient is estimated from them alone.
        """
        representation, settings, count = self.representation, self.settings, batch.log_prob.shape[0]

        def mean_at(observation: Array) -> Mean:
            return policy.evaluate(self.networks, representation, parameters, function, observation)

        if pairs.taken.log_prob.shape[0]:
            mean, alpha = self.from_pairs(mean_at, pairs, key)
        else:
            mean, alpha = self._from_batch(mean_at, batch, key)
        averaged, averaged_state = representation.average(
            function,
            state,
            mean.features,
            alpha,
            lambda wanted: mean_at(batch.obs[evenly_spread_rows(count, wanted)]).features,
            decay=settings.momentum,
        )
        metrics = {"rkhs/alpha": jnp.sqrt(jnp.sum(jnp.square(alpha)))}
        scale: float | Array = 1.0
        shrinkage = settings.shrinkage
        if settings.step == "trust-region":
            if shrinkage:  # taken now, so that the trust region counts it
                averaged, shrinkage = representation.apply(averaged, averaged_state, 0.0, shrinkage=shrinkage), 0.0
            region = self._trust_region(mean_at(batch.obs[:: probe_stride(count)]), mean)
            averaged, averaged_state, scale = region.hold((function, state), (averaged, averaged_state))
        if settings.agreement:
            # KL grows with the square of the step, so the target times cos^2 is the step times cos.
            metrics["rkhs/agreement"] = squared_cosine(representation.activations(averaged, mean.features), alpha)
            scale *= jnp.sqrt(metrics["rkhs/agreement"])
        metrics["rkhs/scale"] = jnp.asarray(scale)
        return representation.apply(averaged, averaged_state, scale, shrinkage=shrinkage), averaged_state, metrics

    def _from_batch(
        self, mean_at: Callable[[Array], Mean], batch: Samples, key: Key[Array, ""]
    ) -> tuple[Mean, Float[Array, "n A"]]:
        """The mean at n transitions of the batch, and their coefficients."""
        gain, advantage = self.gain(batch), objectives.normalised(batch.advantage)
        drawn, gain, advantage = self._draw((batch, gain, advantage), batch.log_prob.shape[0], key)
        mean = mean_at(drawn.obs)
        return mean, self.coefficients(mean, drawn, gain, advantage)

    def from_pairs(
        self, mean_at: Callable[[Array], Mean], pairs: Pairs, key: Key[Array, ""]
    ) -> tuple[Mean, Float[Array, "n A"]]:
        """The mean at the states of n pairs, and their coefficients (Paternain et al. 2020).

        A pair's coefficient is the mean of its two actions'. Both are draws of the policy that acted, so each is
        weighted as any transition is. While that policy is the one of now, the two scores differ in their sign alone,
        and Sigma^-1 (a - m) (G(a) - G(a')) / 2 is left. Whatever of G is the same at both cancels, so that no baseline
        is needed: for the Q of Lemma 3.1 the variance drops from 2 c^2 + Sigma^-1 (c h + d)^2 to 2 c^2.
        """
        weighed = self.weigh_pairs(pairs)
        pairs, gains, advantages = self._draw(weighed, pairs.taken.log_prob.shape[0], key)
        mean = mean_at(pairs.taken.obs)
        return mean, self.pair_coefficients(mean, pairs, gains, advantages)

    def weigh_pairs(self, pairs: Pairs) -> tuple[Pairs, tuple[Array, Array], tuple[Array, Array]]:
        """The pairs, G of their two actions, and the advantages of these normalised over all 2 M."""
        both = objectives.normalised(jnp.stack([pairs.taken.advantage, pairs.mirrored.advantage]))
        gains = (pairs.taken.target, pairs.mirrored.target) if self.target == "Q" else (both[0], both[1])
        return pairs, gains, (both[0], both[1])

    def pair_coefficients(
        self, mean: Mean, pairs: Pairs, gains: tuple[Array, Array], advantages: tuple[Array, Array]
    ) -> Float[Array, "n A"]:
        """The mean of the coefficients of a pair's two actions."""
        taken = self.coefficients(mean, pairs.taken, gains[0], advantages[0])
        mirrored = self.coefficients(mean, pairs.mirrored, gains[1], advantages[1])
        return 0.5 * (taken + mirrored)

    def _draw(self, rows_of: Any, count: int, key: Key[Array, ""]) -> Any:
        """n of the `count` rows of every array, without replacement; all, in their order, where n is their number."""
        if self.samples == count:
            return rows_of
        rows = jax.random.choice(key, count, (self.samples,), replace=False)
        return jax.tree.map(lambda x: x[rows], rows_of)

    def gain(self, batch: Samples) -> Float[Array, "B"]:
        """G: the lambda-return A + V as it is, or the advantage normalised over the batch."""
        return batch.target if self.target == "Q" else objectives.normalised(batch.advantage)

    def coefficients(
        self, mean: Mean, drawn: Samples, gain: Float[Array, "n"], advantage: Float[Array, "n"]
    ) -> Float[Array, "n A"]:
        """alpha_k = eta/n rho_k Sigma^-1 (a_k - m(o_k)) (G_k - D_k), rho = min(r, clip(r)), D as `rkhs.drift` says.

        D is DPO's drift of the normalised advantage, whatever G is. A step size that is found by a rule makes eta 1.
        """
        settings = self.settings
        log_ratio = gaussians.log_prob(mean.total, mean.log_std, drawn.action) - drawn.log_prob
        ratio = jnp.exp(log_ratio)
        held = jnp.minimum(ratio, jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip))
        drift = {"alpha": settings.drift_alpha, "beta": settings.drift_beta}
        if settings.drift == "paper":
            weight = held * (gain - objectives.drift(log_ratio, advantage, **drift))
        elif settings.drift == "derivative":
            # rho / r, which is 1 within the clip, without a quotient of numbers that may both be 0.
            share = jnp.exp(jnp.minimum(jnp.log1p(settings.clip) - log_ratio, 0.0))
            weight = held * gain - share * objectives.drift_slope(log_ratio, advantage, **drift)
        else:
            weight = held * gain
        score = gaussians.score(mean.total, mean.log_std, drawn.action)
        eta = settings.eta if settings.step == "fixed" else 1.0
        return (eta / self.samples) * weight[:, None] * score

    def _trust_region(self, spread: Mean, drawn: Mean) -> TrustRegion:
        """The bound of this step. The drawn transitions are probes, too: the gradient may vanish everywhere else.

        Args:
            spread, drawn: the mean at transitions spread over the batch, and at those the gradient is made of.
        """
        rows = slice(None, None, probe_stride(drawn.features.shape[0]))
        return TrustRegion(
            self.representation,
            self.settings.kl_target,
            jnp.concatenate([spread.features, drawn.features[rows]]),
            jnp.concatenate([spread.rkhs, drawn.rkhs[rows]]),
            spread.log_std,
        )
