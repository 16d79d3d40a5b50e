"""Policies read from snapshots, and the actions they take; shared by actors and evaluators."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import jax
import numpy as np
from jax import Array

from common.config.settings import RunSettings
from common.learners import LEARNERS
from common.maths import gaussians
from common.maths.networks import Networks, make_networks
from common.maths.policy import Policy, act
from common.maths.rkhs.make import make_representation
from common.maths.state import initial_state
from common.maths.trees import from_arrays
from common.precision import chosen_precision


class PolicyReader:
    """Reads the snapshots of a run as policies and computes their actions."""

    def __init__(self, settings: RunSettings) -> None:
        representation = make_representation(settings)
        self._settings = settings
        self._representation = representation
        made: list[Networks] = []

        def shapes() -> Policy:
            networks, policy = self._initial()
            made.append(networks)
            return policy

        # The parameters of a policy come from snapshots: what is needed of the initial one are its shapes.
        self._shapes: Policy = jax.eval_shape(shapes)
        self.networks = made[0]
        self._act = partial(
            act,
            self.networks,
            representation,
            normalise=settings.algorithm.normalise_observations,
        )

    @property
    def shapes(self) -> Policy:
        """The shapes and dtypes of the run's policies, in place of arrays."""
        return self._shapes

    def initial(self) -> Policy:
        """The run's initial policy."""
        return self._initial()[1]

    def read(self, arrays: Mapping[str, np.ndarray | Array]) -> Policy:
        """The policy of a snapshot. Raises CodecError if its arrays do not fit the run's settings."""
        return jax.device_put(from_arrays(self._shapes, arrays))

    def sample(self, policy: Policy, observation: Array, key: Array) -> tuple[Array, Array, Array]:
        """Draw actions a [N, A]; returns a, their log-probabilities [N] and their mirror images 2 mean - a [N, A]."""
        mean = self._act(policy, observation)
        action = gaussians.sample(key, mean.total, mean.log_std)
        return action, gaussians.log_prob(mean.total, mean.log_std, action), 2.0 * mean.total - action

    def features(self, policy: Policy, observation: Array) -> Array:
        """The outputs of the feature network psi at raw observations [N, d], before they are scaled for the kernel."""
        return self._act(policy, observation).features / self.networks.feature_scale

    def mode(self, policy: Policy, observation: Array) -> Array:
        """The deterministic actions [N, A]."""
        return self._act(policy, observation).total

    def _initial(self) -> tuple[Networks, Policy]:
        settings, task = self._settings, self._settings.sizes
        networks, parameters = make_networks(
            task.observation_size,
            task.action_size,
            settings.algorithm.hidden,
            settings.seed,
            LEARNERS[settings.learner],
            chosen_precision(settings.algorithm.precision),
        )
        state = initial_state(
            networks,
            parameters,
            settings.algorithm,
            representation=self._representation,
            slots=1,
            envs_per_slot=1,
            seed=settings.seed,
        )
        return networks, state.policy
