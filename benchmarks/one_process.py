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
from common.physics import engines
from common.runtime import enable_compilation_cache
from services.actor.collector import Collector, SlotGeneration
from services.actor.rollouts import rollout_message
from services.learner.reporting.statistics import Episodes
from services.learner.training.trainer import Trainer
from services.worker.joining import Assignment
from services.worker.policy_reader import PolicyReader

UPDATES = 40
WARM_UP = 3


@dataclass(frozen=True)
class Step:
    """One update: the episodes that ended in its rollout, and seconds by phase.

    Phases: `physics` (where it can be told apart), `policy` (the rest of collecting), `learner` and `hand_over`
    (policy to the actor's half, rollout to the learner's).
    """

    episodes: Episodes
    seconds: dict[str, float]


class OneProcess:
    """One actor and the learner of a run, alternating in one process."""

    def __init__(self, settings: RunSettings) -> None:
        """Compile everything. `settings.actors` must be 1."""
        self._assignment = Assignment("benchmark", 0, 0, "one-process", settings)
        self._trainer = Trainer(settings)
        self._reader = PolicyReader(settings)
        self._collector = Collector(settings, SlotGeneration(slot=0, generation=0), self._reader)
        self._collector.compile()
        self._trainer.compile()

    @property
    def physics(self) -> str:
        return self._collector.physics

    def step(self) -> Step:
        """Collect one rollout with the newest policy and update on it."""
        began_s = time.perf_counter()
        policy = self._reader.read(self._trainer.policy_arrays())
        collected, timing = self._collector.collect(policy)
        rollout = rollout_message(
            collected, self._assignment, seq=self._collector.seq, version=self._trainer.version, timing=timing
        )
        self._collector.keep()
        collected_s = time.perf_counter()
        self._trainer.update([rollout])
        seconds = {
            "policy": timing["collect"],
            "learner": time.perf_counter() - collected_s,
            "hand_over": collected_s - began_s - sum(timing.values()),
        }
        if "physics" in timing:
            seconds["physics"] = timing["physics"]
        return Step(Episodes.of([rollout]), seconds)

    def digest(self) -> str:
        """Hex digest of the learner's state, equal to that of a service run with the same settings."""
        return self._trainer.digest()


def prepare() -> None:
    """Configure JAX as in an actor. Call this before any computation.

    The learner alone would leave asynchronous dispatch on; its update is as fast without, and gives the same bits.
    """
    enable_compilation_cache()
    engines.require_synchronous_dispatch()


def measure(settings: RunSettings, *, warm_up: int) -> dict[str, Any]:
    """Make all updates of the run; returns speed and mean seconds by phase over those after the first `warm_up`.

    Raises:
        SettingsError: no update is left to be measured.
    """
    if not 0 <= warm_up < settings.updates:
        raise SettingsError(f"--warm-up {warm_up} leaves nothing of {settings.updates} updates; choose fewer")
    work = OneProcess(settings)
    steps = [work.step() for _ in range(warm_up)]
    began_s = time.perf_counter()
    steps += [work.step() for _ in range(settings.updates - warm_up)]
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
        "return_sum": [float(step.episodes.returns.sum()) for step in steps],
        "episodes": [len(step.episodes.returns) for step in steps],
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
