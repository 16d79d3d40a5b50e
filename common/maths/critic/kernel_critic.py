"""The kernel critic V(s) = V_net(s) + g(s): g is the kernel ridge regression of what the network leaves over.

After the networks have trained on a batch, g is fitted in closed form to the residual `target - V_net` of that batch,
target the lambda-return. It stays as it is until the next batch has been used, so that it values states that it was
not fitted on.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from common.config.critic import CriticSettings
from common.config.settings import RunSettings
from common.maths.critic import ridge
from common.maths.critic.functions import Functions, Points, make_functions
from common.maths.critic.ridge import Equations
from common.maths.networks import Networks, Parameters

Metrics = dict[str, Array]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NoCorrection:
    """The state of a run without a kernel critic: no arrays."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Correction:
    """g = phi @ weights, and the equations it was solved from."""

    points: Points
    weights: Float[Array, "M"]
    equations: Equations


CriticState = NoCorrection | Correction

NO_CORRECTION = NoCorrection()


@dataclass(frozen=True)
class KernelCritic:
    """The critic of a run, its settings bound."""

    networks: Networks
    settings: CriticSettings
    functions: Functions

    def empty(self) -> CriticState:
        """g = 0."""
        if self.settings.representation == "none":
            return NO_CORRECTION
        size = self.functions.size
        return Correction(self.functions.start(), jnp.zeros((size,), jnp.float32), ridge.no_equations(size))

    def correction(self, state: Correction, parameters: Parameters, obs: Float[Array, "B O"]) -> Float[Array, "B"]:
        """g at standardised observations."""
        return self.functions(state.points, self._inputs(parameters, obs)) @ state.weights

    def value(self, state: CriticState, parameters: Parameters, obs: Float[Array, "B O"]) -> Float[Array, "B"]:
        """V_net + g at standardised observations."""
        value = self.networks.value(parameters["critic"], obs)
        if isinstance(state, NoCorrection):
            return value
        return value + self.correction(state, parameters, obs)

    def refit(
        self,
        state: CriticState,
        parameters: Parameters,
        obs: Float[Array, "T E O"],
        target: Float[Array, "T E"],
    ) -> tuple[CriticState, Metrics]:
        """The next g, for the networks as they are after their training.

        Environments are the unit that is held out: steps of one episode are too alike to judge each other. Where their
        number is odd, the last one is left out.
        """
        if isinstance(state, NoCorrection):
            return state, {}
        settings, obs = self.settings, _halves(obs)
        inputs = self._inputs(parameters, obs)
        points = self.functions.renew(state.points, inputs)
        phi = self.functions(points, inputs)
        residual = _halves(target) - self.networks.value(parameters["critic"], obs)
        newest = ridge.equations(phi.reshape(2, -1, phi.shape[1]), residual.reshape(2, -1))
        fitted = ridge.discounted_sum(state.equations, newest, settings.forgetting)
        r2 = ridge.held_out_r2(fitted, newest, settings.ridge)
        weights = ridge.solve(jnp.sum(fitted.matrix, axis=0), jnp.sum(fitted.right, axis=0), settings.ridge)
        if settings.shrink:
            weights = jnp.clip(r2, 0.0, 1.0) * weights
        metrics = {
            "critic/held_out_r2": r2,
            "critic/residual_rms": jnp.sqrt(jnp.mean(jnp.square(residual))),
            "critic/norm": jnp.linalg.norm(weights),
        }
        return Correction(points, weights, fitted), metrics

    def _inputs(self, parameters: Parameters, obs: Float[Array, "B O"]) -> Float[Array, "B d"]:
        """The inputs of g, in units that make distances of order one: z / sqrt(d), o / sqrt(O)."""
        networks, kind = self.networks, self.settings.inputs
        if kind == "critic":
            return networks.critic_features(parameters["critic"], obs)
        whitened = obs * (obs.shape[-1] ** -0.5)
        if kind == "observations":
            return whitened
        z = networks.bind_policy(parameters["policy"]).features(obs) * networks.feature_scale
        return z if kind == "features" else jnp.concatenate([z, whitened], axis=1)


def _halves(x: Array) -> Array:
    """Transitions [T, E, ...] in one axis, those of the first half of the environments first."""
    half = x.shape[1] // 2
    apart = x[:, : 2 * half].reshape(x.shape[0], 2, half, *x.shape[2:])
    return jnp.moveaxis(apart, 1, 0).reshape(-1, *x.shape[2:])


def make_kernel_critic(settings: RunSettings, networks: Networks) -> KernelCritic:
    """The critic of a run."""
    critic = settings.critic
    sizes = {
        "features": networks.feature_size,
        "critic": settings.algorithm.hidden[-1],
        "observations": networks.observation_size,
        "both": networks.feature_size + networks.observation_size,
    }
    return KernelCritic(networks, critic, make_functions(critic, sizes[critic.inputs], settings.seed))
