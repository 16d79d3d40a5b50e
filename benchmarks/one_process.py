"""A run in one process: environments, policy and update without a transport.

    python -m benchmarks.one_process --task hopper --learner dpo --num-envs 2048 --updates 40

The service's collector and trainer, with policy and rollouts passed in memory. Without transport, log, checkpoints and
digests, it is the baseline for the service. Prints one JSON object on one line.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from common.config.settings import RunSettings
from common.config.sources import add_options, load
from common.errors import ReskpnError, SettingsError
from reskpn.study.in_process import InProcess, Step, prepare

UPDATES = 40
WARM_UP = 3


@dataclass(frozen=True)
class Timed:
    """What is kept of an update: a run's rollouts together would fill the memory."""

    return_sum: float
    episodes: int
    seconds: dict[str, float]

    @classmethod
    def of(cls, step: Step) -> Timed:
        returns = step.rollout.episode_return
        return cls(float(returns.sum()), len(returns), step.seconds)


def measure(settings: RunSettings, *, warm_up: int) -> dict[str, Any]:
    """Make all updates of the run; returns speed and mean seconds by phase over those after the first `warm_up`.

    Raises:
        SettingsError: no update is left to be measured.
    """
    if not 0 <= warm_up < settings.updates:
        raise SettingsError(f"--warm-up {warm_up} leaves nothing of {settings.updates} updates; choose fewer")
    work = InProcess(settings)
    steps = [Timed.of(work.step()) for _ in range(warm_up)]
    began_s = time.perf_counter()
    steps += [Timed.of(work.step()) for _ in range(settings.updates - warm_up)]
    elapsed_s = time.perf_counter() - began_s
    counted = steps[warm_up:]
    seconds = {name: sum(step.seconds[name] for step in counted) / len(counted) for name in counted[0].seconds}
    return {
        "task": settings.task,
        "learner": settings.learner,
        "physics": work.physics,
        "seed": settings.seed,
        "num_envs": settings.num_envs,
        "num_steps": settings.num_steps,
        "updates": settings.updates,
        "warm_up": warm_up,
        "env_steps_per_s": len(counted) * settings.batch_size / elapsed_s,
        "seconds": seconds | {"update": elapsed_s / len(counted)},
        "state_digest": work.digest(),
        "return_sum": [step.return_sum for step in steps],
        "episodes": [step.episodes for step in steps],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.one_process",
        description="The work of a run in one process, without a service. Every setting of a run is an option.",
        usage="%(prog)s [options]",
        allow_abbrev=False,
    )
    options = add_options(parser)
    parser.add_argument("--updates", type=int, help=f"updates to make (default: as --total-steps says, or {UPDATES})")
    parser.add_argument("--warm-up", type=int, default=WARM_UP, help=f"first updates not measured (default {WARM_UP})")
    parser.add_argument("--returns", action="store_true", help="also print episodes and returns of every update")
    given = parser.parse_args(arguments)
    try:
        settings = _settings(load(options, given, config=given.config), given.updates)
        prepare()
        result = measure(settings, warm_up=given.warm_up)
    except ReskpnError as error:
        print(f"one_process: {error}", file=sys.stderr)
        return error.exit_code
    hidden = () if given.returns else ("return_sum", "episodes")
    print(json.dumps({name: value for name, value in result.items() if name not in hidden}))
    return 0


def _settings(settings: RunSettings, updates: int | None) -> RunSettings:
    """The settings for one process and `updates` updates."""
    if updates is None and "total_steps" not in settings.model_fields_set:
        updates = UPDATES
    steps = settings.total_steps if updates is None else updates * settings.batch_size
    return settings.model_copy(update={"actors": 1, "total_steps": steps})


if __name__ == "__main__":
    sys.exit(main())
