"""PPO of rsl_rl on this project's own environments, until it is stopped. Runs in the peers' environment.

build/peers/.venv/bin/python -m benchmarks.peers.rsl --task hopper-v5 --seed 0
"""

from __future__ import annotations

import argparse
import copy
import sys
from typing import Any

import jax
import numpy as np
import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from benchmarks.race.reporting import Reporter
from common.errors import ReskpnError
from common.physics import engines
from common.physics.environments import make_environment
from common.tasks import GYMNASIUM

ITERATIONS = 10**9
NUM_ENVS = 4096

_NETWORK = {"class_name": "MLPModel", "hidden_dims": [400, 200, 100], "activation": "elu", "obs_normalization": True}

SETTINGS: dict[str, Any] = {
    "num_steps_per_env": 32,
    "save_interval": ITERATIONS,
    "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
    "actor": _NETWORK | {"distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 1.0}},
    "critic": _NETWORK,
    "algorithm": {
        "class_name": "PPO",
        "num_learning_epochs": 5,
        "num_mini_batches": 4,
        "clip_param": 0.2,
        "gamma": 0.99,
        "lam": 0.95,
        "value_loss_coef": 1.0,
        "entropy_coef": 0.0,
        "learning_rate": 5e-4,
        "max_grad_norm": 1.0,
        "use_clipped_value_loss": True,
        "schedule": "adaptive",
        "desired_kl": 0.01,
    },
}
"""Sizes as rsl_rl is used with for Isaac Lab's ant, which is the nearest to these tasks; observations normalised, since
Gymnasium's are not scaled."""


class Adapted(VecEnv):
    """A batch of this project's environments as rsl_rl wants them, each episode starting in a new state."""

    def __init__(self, task: str, num_envs: int, seed: int, reporter: Reporter) -> None:
        self.max_episode_length = GYMNASIUM[task].episode_length
        self._envs = make_environment(task, "native", num_envs=num_envs, episode_length=int(self.max_episode_length))
        self._key = jax.random.key(seed)
        self._state = self._envs.reset(self._next_key())
        self._reporter = reporter
        self._steps = 0
        self.num_envs, self.num_actions = num_envs, self._envs.action_size
        self.device, self.cfg = "cpu", {"task": task}
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.long)

    def get_observations(self) -> TensorDict:
        return TensorDict({"policy": _tensor(self._state.obs)}, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        self._state, now = self._envs.step(self._state, actions.numpy(), self._next_key())
        done = np.asarray(now.terminated | now.truncated)
        self._steps += self.num_envs
        self._reporter.add(self._steps, int(done.sum()), float(np.asarray(now.episode_return)[done].sum()))
        self.episode_length_buf = _tensor(self._state.steps).long()
        extras = {"time_outs": _tensor(now.truncated)}
        return self.get_observations(), _tensor(now.reward), torch.from_numpy(done.astype(np.int64)), extras

    def _next_key(self) -> jax.Array:
        self._key, key = jax.random.split(self._key)
        return key


def _tensor(array: jax.Array) -> torch.Tensor:
    """A copy: JAX may use the memory again."""
    return torch.from_numpy(np.array(array))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.rsl", description=__doc__)
    parser.add_argument("--task", required=True, choices=sorted(GYMNASIUM), help="task")
    parser.add_argument("--seed", type=int, required=True, help="seed of everything")
    parser.add_argument("--num-envs", type=int, default=NUM_ENVS, metavar="N", help="environments")
    given = parser.parse_args()
    engines.require_synchronous_dispatch()
    torch.manual_seed(given.seed)
    reporter = Reporter(("rsl-rl-lib", "torch", "jax", "mujoco"), SETTINGS | {"num_envs": given.num_envs})
    try:
        adapted = Adapted(given.task, given.num_envs, given.seed, reporter)
        OnPolicyRunner(adapted, copy.deepcopy(SETTINGS), log_dir=None, device="cpu").learn(ITERATIONS)
    except ReskpnError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
