"""The entrant `reference`: `benchmarks.reference` with PureJaxRL's sizes, until it is stopped.

python -m benchmarks.race.reference --task hopper-v5 --seed 0
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict

from benchmarks.race.reporting import Reporter
from benchmarks.reference import Recipe, prepare, training
from common.errors import ReskpnError
from common.tasks import GYMNASIUM

UPDATES = 200_000
"""More than a run gets to: it is stopped before."""


def recipe(task: str) -> Recipe:
    """PureJaxRL's PPO for continuous actions on one of Gymnasium's tasks, each episode starting in a new state."""
    return Recipe(task, "ppo", episode_length=GYMNASIUM[task].episode_length, new_states=True)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.race.reference", description=__doc__)
    parser.add_argument("--task", required=True, choices=sorted(GYMNASIUM), help="task")
    parser.add_argument("--seed", type=int, required=True, help="seed of everything")
    given = parser.parse_args()
    prepare()
    chosen = recipe(given.task)
    reporter = Reporter(("jax", "optax", "mujoco"), asdict(chosen))
    batch = chosen.num_envs * chosen.num_steps
    try:
        for update, (return_sum, episodes) in enumerate(training(chosen, UPDATES, given.seed), start=1):
            reporter.add(update * batch, episodes, return_sum)
    except ReskpnError as error:
        print(f"reference: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
