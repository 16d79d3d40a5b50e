"""PPO of brax on MJX with the sizes of the paper's Table 1, until it is stopped.

python -m benchmarks.peers.brax_ppo --task hopper --seed 0
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax import envs
from brax.envs.base import Env, State, Wrapper
from brax.envs.wrappers.training import wrap
from brax.training.agents.ppo import train

from benchmarks.race.reporting import Reporter

FOREVER = 2 * 10**8
"""Environment steps: more than a CPU makes in a day. brax keeps the metrics of all of them in memory."""

SETTINGS: dict[str, Any] = {
    "num_envs": 2048,
    "unroll_length": 10,
    "batch_size": 64,  # rollouts of a minibatch: 32 of them are 2,048
    "num_minibatches": 32,
    "num_updates_per_batch": 4,
    "episode_length": 1000,
    "learning_rate": 3e-4,
    "discounting": 0.99,
    "gae_lambda": 0.95,
    "entropy_cost": 0.0,
    "clipping_epsilon": 0.2,
    "max_grad_norm": 0.5,
    "normalize_observations": True,
}


class Watched(Wrapper):
    """Reports the episodes of N environments as they end."""

    def __init__(self, env: Env, reporter: Reporter) -> None:
        super().__init__(env)
        self._reporter = reporter
        self._steps = 0

    def step(self, state: State, action: jax.Array) -> State:
        state = self.env.step(state, action)
        jax.debug.callback(self._report, state.info["episode_metrics"]["sum_reward"], state.info["episode_done"])
        return state

    def _report(self, returns: Any, done: Any) -> None:
        ended = np.asarray(returns)[np.asarray(done) > 0]
        self._steps += np.size(returns)
        self._reporter.add(self._steps, len(ended), float(ended.sum()))


def _replicated(tree: Any, devices: Sequence[jax.Device]) -> Any:
    """What `jax.device_put_replicated` was: brax 0.14.2 calls it, and jax 0.10 has only its name left."""
    return jax.tree.map(lambda x: jnp.stack([x] * len(devices)), tree)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.brax_ppo", description=__doc__)
    parser.add_argument("--task", required=True, help="name in brax.envs")
    parser.add_argument("--seed", type=int, required=True, help="seed of everything")
    given = parser.parse_args()
    reporter = Reporter(("brax", "jax", "mujoco-mjx"), SETTINGS | {"backend": "mjx"})

    def watched(env: Env, **options: Any) -> Env:
        return Watched(wrap(env, **options), reporter)

    vars(jax)["device_put_replicated"] = _replicated
    environment = envs.get_environment(given.task, backend="mjx")
    train.train(
        environment,
        num_timesteps=FOREVER,
        seed=given.seed,
        wrap_env_fn=watched,
        run_evals=False,
        num_evals=2,
        **SETTINGS,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
