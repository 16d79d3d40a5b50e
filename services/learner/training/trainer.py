"""The learner without its service: rollouts in, the next state and its digest out.

The same calls serve a live run, an in-process benchmark and a replay, so a log re-executes to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding

from common.config.settings import RunSettings
from common.errors import NumericsError
from common.learners import LEARNERS
from common.maths import trees
from common.maths.diagnostics import MEASURED
from common.maths.networks import make_networks
from common.maths.rkhs.make import make_representation
from common.maths.state import Batch, LearnerState, initial_state
from common.maths.update import Metrics, make_update
from common.precision import chosen_precision
from common.wire.messages import digest_arrays
from common.wire.rollout import Rollout
from services.learner.training.batches import assemble
from services.learner.training.devices import by_row, device_mesh, everywhere
from services.learner.training.sampling import sampling_problem

FINITE = "finite/"


class Trainer:
    """Holds the state of one run and applies updates to it."""

    def __init__(self, settings: RunSettings) -> None:
        task = settings.sizes
        networks, parameters = make_networks(
            task.observation_size,
            task.action_size,
            settings.algorithm.hidden,
            settings.seed,
            LEARNERS[settings.learner],
            chosen_precision(settings.algorithm.precision),
        )
        self._settings = settings
        self._iteration = make_update(settings, networks)
        self._state = initial_state(
            networks,
            parameters,
            settings.algorithm,
            representation=make_representation(settings),
            slots=settings.actors,
            envs_per_slot=settings.envs_per_actor,
            seed=settings.seed,
            critic=self._iteration.critic.empty(),
        )
        self._everywhere: NamedSharding | None = None
        if settings.algorithm.devices > 1:
            mesh = device_mesh(settings.algorithm.devices)
            self._everywhere = everywhere(mesh)
            self._iteration = replace(self._iteration, rows_on=by_row(mesh))
            self._state = jax.device_put(self._state, self._everywhere)
        self._update: Callable[[LearnerState, Batch], tuple[LearnerState, Metrics]] = self._jitted()
        self._version = 0

    @property
    def version(self) -> int:
        """Updates applied so far."""
        return self._version

    def compile(self) -> None:
        """Compile the update for the run's shapes now, so that the first one does not wait for it."""
        batch = jax.eval_shape(lambda: _empty_batch(self._settings))
        self._update = self._jitted().lower(self._state, batch).compile()

    def _jitted(self) -> Any:
        """The update, compiled when it is called or lowered."""
        if self._everywhere is None:
            return jax.jit(self._iteration)
        return jax.jit(self._iteration, in_shardings=self._everywhere, out_shardings=self._everywhere)

    def update(self, rollouts: Sequence[Rollout]) -> dict[str, float]:
        """Apply one update; returns its metrics by name.

        Raises:
            NumericsError: a part of the new state is not finite, or its policy cannot be sampled from. The state stays
                as it was.
        """
        batch = assemble(rollouts)
        if self._everywhere is not None:
            batch = jax.device_put(batch, self._everywhere)
        state, metrics = self._update(self._state, batch)
        metrics, log_std = jax.device_get((metrics, state.policy.parameters["log_std"]))
        values = {name: float(value) for name, value in metrics.items()}
        broken = [name.removeprefix(FINITE) for name, value in values.items() if name.startswith(FINITE) and not value]
        if broken:
            raise NumericsError(
                f"update {self._version + 1} made the {' and the '.join(broken)} not finite; it was not applied. "
                "The log holds the rollouts it was made from; try a smaller algorithm.learning_rate or rkhs.eta"
            )
        if (problem := sampling_problem(log_std)) is not None:
            algorithm = self._settings.algorithm
            raise NumericsError(
                f"update {self._version + 1} made a policy that cannot be sampled from; it was not applied. {problem}. "
                f"What moves log_std is algorithm.entropy_coefficient ({algorithm.entropy_coefficient:g}) and "
                f"algorithm.learning_rate ({algorithm.learning_rate:g}): choose smaller ones, or bound log_std by "
                "algorithm.max_log_std"
            )
        self._adopt(state)
        return _meant(values)

    def digest(self) -> str:
        """Hex digest of the whole state."""
        return digest_arrays(self.state_arrays())

    def state_arrays(self) -> dict[str, np.ndarray]:
        """The whole state by path: what a checkpoint keeps."""
        return trees.to_arrays(self._state)

    def policy_arrays(self) -> dict[str, np.ndarray]:
        """The arrays that acting needs, by path: the content of a snapshot."""
        return trees.to_arrays(self._state.policy)

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Go on from the state of a checkpoint; CodecError where it does not fit the settings."""
        self._adopt(jax.device_put(trees.from_arrays(self._state, arrays), self._everywhere))

    def _adopt(self, state: LearnerState) -> None:
        self._state = state
        self._version = int(state.version)


def _meant(values: dict[str, float]) -> dict[str, float]:
    """The metrics without flags, and without those of `variance/` where they were not measured."""
    measured = bool(values.get(MEASURED, 0.0))
    return {
        name: value
        for name, value in values.items()
        if not name.startswith(FINITE) and name != MEASURED and (measured or not name.startswith("variance/"))
    }


def _empty_batch(settings: RunSettings) -> Batch:
    """A batch of the run's shapes."""
    task = settings.sizes
    steps, envs = settings.num_steps, settings.num_envs
    per_step = jnp.zeros((steps, envs), jnp.float32)
    flag = jnp.zeros((steps, envs), jnp.bool_)
    obs = jnp.zeros((envs, task.observation_size), jnp.float32)
    branches = settings.branches
    return Batch(
        obs=jnp.zeros((steps, envs, task.observation_size), jnp.float32),
        action=jnp.zeros((steps, envs, task.action_size), jnp.float32),
        log_prob=per_step,
        reward=per_step,
        terminated=flag,
        truncated=flag,
        last_obs=obs,
        truncated_obs=obs,
        slot=jnp.zeros((settings.actors,), jnp.int32),
        fresh=jnp.zeros((settings.actors,), jnp.bool_),
        mirror_action=jnp.zeros((branches, task.action_size), jnp.float32),
        mirror_reward=per_step[0, :branches],
        mirror_terminated=flag[0, :branches],
        mirror_truncated=flag[0, :branches],
        mirror_obs=obs[:branches],
    )
