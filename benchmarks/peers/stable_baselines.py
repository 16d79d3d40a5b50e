"""PPO of Stable-Baselines3 and of SBX on one of Gymnasium's environments, until it is stopped.

Runs in the peers' environment.

    build/peers/.venv/bin/python -m benchmarks.peers.stable_baselines --library sb3 --environment Hopper-v5 --seed 0

Built as RL Baselines3 Zoo builds it: its settings, monitored environments one after the other in one process,
observations and rewards normalised.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from benchmarks.peers.zoo import CONSTRUCTOR, recommended
from benchmarks.race.reporting import Reporter
from common.errors import SettingsError

FOREVER = 10**12
PACKAGES = {
    "sb3": ("stable-baselines3", "torch", "gymnasium", "mujoco", "rl_zoo3"),
    "sbx": ("sbx-rl", "stable-baselines3", "jax", "torch", "gymnasium", "mujoco", "rl_zoo3"),
}


class Episodes(BaseCallback):
    """Reports the episodes as they end. Returns are those of the environment, before they are normalised."""

    def __init__(self, reporter: Reporter) -> None:
        super().__init__()
        self._reporter = reporter

    def _on_step(self) -> bool:
        returns = [float(info["episode"]["r"]) for info in self.locals["infos"] if "episode" in info]
        self._reporter.add(self.num_timesteps, len(returns), sum(returns))
        return True


def build(library: str, environment: str, seed: int, settings: dict[str, Any]) -> Any:
    """The model with its normalised environments."""
    envs = make_vec_env(environment, n_envs=settings.get("n_envs", 1), seed=seed)
    if settings.get("normalize"):
        envs = VecNormalize(envs, gamma=settings.get("gamma", 0.99))
    policy = dict(settings["policy_kwargs"])
    if library == "sb3":
        from stable_baselines3 import PPO

        modules: Any = torch.nn
        convert = lambda name: getattr(modules, name)  # noqa: E731
    else:
        from flax import linen
        from sbx import PPO

        convert = lambda name: getattr(linen, name.lower())  # noqa: E731
    if "activation_fn" in policy:
        policy["activation_fn"] = convert(policy["activation_fn"])
    given = {name: value for name, value in settings.items() if name in CONSTRUCTOR}
    return PPO(settings["policy"], envs, seed=seed, device="cpu", policy_kwargs=policy, **given)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.stable_baselines", description=__doc__)
    parser.add_argument("--library", required=True, choices=sorted(PACKAGES), help="library")
    parser.add_argument("--environment", required=True, help="name in Gymnasium's registry")
    parser.add_argument("--seed", type=int, required=True, help="seed of everything")
    parser.add_argument("--threads", type=int, default=0, help="threads of torch; 0: its own choice")
    given = parser.parse_args()
    try:
        settings = recommended(given.environment)
    except SettingsError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    if given.threads:
        torch.set_num_threads(given.threads)
    reporter = Reporter(PACKAGES[given.library], settings | {"torch_threads": torch.get_num_threads()})
    model = build(given.library, given.environment, given.seed, settings)
    model.learn(FOREVER, callback=Episodes(reporter))
    return 0


if __name__ == "__main__":
    sys.exit(main())
