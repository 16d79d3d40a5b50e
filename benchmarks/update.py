"""The cost of the kernel parts: the time of an update relative to PPO's, for every representation and the critic.

    python -m benchmarks.update --task hopper --task humanoid --rounds 5
    python -m benchmarks.update --default

Updates of 20,480 random transitions of the task's sizes, 4 epochs of 32 minibatches, on all cores. The cases
alternate, so that other load affects all of them alike; a ratio is the median over the rounds of the time relative to
PPO's in the same round.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.machine import describe, machine
from common.config.settings import RunSettings
from common.config.sources import from_values
from common.learners import LEARNERS
from common.maths.networks import make_networks
from common.maths.rkhs.make import make_representation
from common.maths.state import Batch, initial_state
from common.maths.update import make_update
from common.numerical_environment import factorise_on_one_thread
from common.precision import chosen_precision
from common.runtime import enable_compilation_cache
from common.tasks import TASKS

PAPER = """\
The paper's training times: ResKPN by PPO 3.3 (Half Cheetah), 7.0 (Hopper), 6.2 (Humanoid), from its Table 4;
ResKPN with n = 5 by n = 1 15.5 (Half Cheetah) and 18.7 (Hopper), from its Table 3."""

Rkhs = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A row of the table; PPO if it has no `rkhs`, with a kernel critic if it has `critic`."""

    name: str
    rkhs: Rkhs | None
    critic: dict[str, Any] = field(default_factory=dict)
    precision: str = "float32"
    products: str | None = None
    """JAX's precision of float32 products, for those that name none; None: the device's default, on GPUs TF32."""
    of_default: str = ""
    """A learner: the settings are then those of the default preset for it, sizes included."""

    def settings(self, task: str, sizes: Mapping[str, Any]) -> RunSettings:
        """The settings of its run. `sizes`: settings of the run's size; those of `algorithm` as a map."""
        if self.of_default:
            return from_values({"task": task, "learner": self.of_default, "actors": 1})
        return RunSettings.model_validate(
            {
                "task": task,
                "learner": "reskpn" if self.rkhs else "ppo",
                "actors": 1,
                "rkhs": self.rkhs or {},
                "critic": self.critic,
                **sizes,
                "algorithm": {**sizes.get("algorithm", {}), "precision": self.precision},
            }
        )


def _case(representation: str, samples: int | str, capacity: int, **more: Any) -> Case:
    n = "B" if samples == "batch" else f"{samples}"
    step = {"step": "trust-region"} if more.pop("trust", False) else {}
    rkhs = {"representation": representation, "samples": samples, "capacity": capacity, **step, **more}
    words = [f"{representation} n={n} M={capacity}", *step.values(), *more.values()]
    return Case(" ".join(words), rkhs)


CASES = (
    Case("ppo", None),
    _case("exact", 1, 2441),
    _case("exact", 1, 256),
    _case("exact", 5, 256),
    _case("exact", 64, 256),
    *(_case(name, samples, 256) for name in ("nystrom", "rff") for samples in (1, 5, 64, "batch")),
    _case("rff", "batch", 256, estimate="symmetric"),
    _case("nystrom", "batch", 256, trust=True),
    _case("rff", "batch", 256, trust=True),
    _case("kmp", 1, 256),
    _case("kmp", "batch", 256),
    _case("cluster", 1, 256),
    _case("basis", "batch", 256),
    Case("ppo bfloat16", None, precision="bfloat16"),
    Case("exact n=1 M=256 bfloat16", {"samples": 1, "capacity": 256}, precision="bfloat16"),
    *(Case(f"critic {name}", None, {"representation": name}) for name in ("rff", "nystrom", "linear")),
)

DEFAULT_CASES = (
    Case("ppo", None, of_default="ppo"),
    Case("dpo", None, of_default="dpo"),
    Case("default", None, of_default="reskpn"),
)
"""The default preset beside the learners without kernel parts, all at its sizes."""

WHOLE_EXACT = _case("exact", "batch", 20480)


class Subject:
    """A compiled case and its state."""

    def __init__(self, case: Case, task: str, sizes: Mapping[str, Any] | None = None) -> None:
        """`sizes`: as in `Case.settings`."""
        factorise_on_one_thread()
        settings = case.settings(task, sizes or {})
        shape, learner = TASKS[task], LEARNERS[settings.learner]
        networks, parameters = make_networks(
            shape.observation_size,
            shape.action_size,
            settings.algorithm.hidden,
            settings.seed,
            learner,
            chosen_precision(settings.algorithm.precision),
        )
        update = make_update(settings, networks)
        self._state = initial_state(
            networks,
            parameters,
            settings.algorithm,
            representation=make_representation(settings),
            slots=1,
            envs_per_slot=settings.num_envs,
            seed=settings.seed,
            critic=update.critic.empty(),
        )
        self.name = case.name
        self._batch = _random_batch(settings)
        with jax.default_matmul_precision(case.products):
            self._update = jax.jit(update).lower(self._state, self._batch).compile()

    def hlo(self) -> str:
        """The compiled program as text."""
        text = self._update.as_text()
        assert text is not None
        return text

    def seconds(self) -> tuple[float, float]:
        """Wall time of one more update and its CPU time, which other programs on the machine affect less."""
        began, used = time.perf_counter(), time.process_time()
        self._state, metrics = jax.block_until_ready(self._update(self._state, self._batch))
        elapsed = time.perf_counter() - began, time.process_time() - used
        if not all(metrics[name] for name in metrics if name.startswith("finite/")):
            raise FloatingPointError(f"{self.name} is not finite: its time would mean nothing")
        return elapsed


def _random_batch(settings: RunSettings) -> Batch:
    """Transitions of an untrained policy in which no episode ends."""
    rng = np.random.default_rng(0)
    task, steps, envs = TASKS[settings.task], settings.num_steps, settings.num_envs

    def normal(*shape: int) -> jax.Array:
        return jnp.asarray(rng.standard_normal(shape), jnp.float32)

    action = normal(steps, envs, task.action_size)
    flag = jnp.zeros((steps, envs), jnp.bool_)
    return Batch(
        obs=normal(steps, envs, task.observation_size),
        action=action,
        log_prob=(-0.5 * (action**2 + np.log(2 * np.pi))).sum(axis=-1),
        reward=normal(steps, envs),
        terminated=flag,
        truncated=flag,
        last_obs=normal(envs, task.observation_size),
        truncated_obs=jnp.zeros((envs, task.observation_size), jnp.float32),
        slot=jnp.zeros(1, jnp.int32),
        fresh=jnp.zeros(1, jnp.bool_),
        mirror_action=normal(settings.branches, task.action_size),
        mirror_reward=normal(settings.branches),
        mirror_terminated=flag[0, : settings.branches],
        mirror_truncated=flag[0, : settings.branches],
        mirror_obs=normal(settings.branches, task.observation_size),
    )


def measure(task: str, cases: Sequence[Case], rounds: int) -> list[dict[str, Any]]:
    """As `in_turns`, for cases that are compiled here."""
    return in_turns([Subject(case, task) for case in cases], rounds)


def in_turns(subjects: Sequence[Subject], rounds: int) -> list[dict[str, Any]]:
    """Name, median seconds and ratio to the first subject, over `rounds` rounds after one for warm-up."""
    both = np.array([[subject.seconds() for subject in subjects] for _ in range(rounds + 1)])[1:]
    times, used = both[:, :, 0], both[:, :, 1]
    ratios, used_ratios = times / times[:, :1], used / used[:, :1]
    return [
        {
            "case": subject.name,
            "seconds": statistics.median(times[:, i]),
            "ratio": statistics.median(ratios[:, i]),
            "cpu_seconds": statistics.median(used[:, i]),
            "cpu_ratio": statistics.median(used_ratios[:, i]),
            "ratio_low": float(ratios[:, i].min()),
            "ratio_high": float(ratios[:, i].max()),
        }
        for i, subject in enumerate(subjects)
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.update", description="The time of an update against PPO's, for every way to keep h."
    )
    parser.add_argument("--task", action="append", choices=TASKS, help="default: hopper and humanoid")
    parser.add_argument("--rounds", type=int, default=5, help="updates of each case (default 5)")
    parser.add_argument("--only", action="append", help="cases whose name has this in it, beside ppo; may be repeated")
    parser.add_argument(
        "--whole-exact", action="store_true", help="also exact with the whole batch as centres: minutes"
    )
    parser.add_argument(
        "--default",
        action="store_true",
        help="the default preset beside PPO and DPO at its sizes, in place of all these",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object in place of the tables")
    given = parser.parse_args(arguments)
    enable_compilation_cache()
    found = machine()
    cases = [*DEFAULT_CASES] if given.default else [*CASES, *([WHOLE_EXACT] if given.whole_exact else [])]
    if given.only:
        cases = [cases[0], *(case for case in cases[1:] if any(part in case.name for part in given.only))]
    tables = {task: measure(task, cases, given.rounds) for task in given.task or ("hopper", "humanoid")}
    if given.json:
        print(json.dumps({"machine": found, "rounds": given.rounds, "tables": tables}))
        return 0
    print(*describe(found), PAPER, sep="\n")
    for task, rows in tables.items():
        print(f"\n{task}: update of {cases[0].settings(task, {}).batch_size:,} transitions, {given.rounds} rounds")
        print(f"{'case':34} {'seconds':>8} {'by ppo':>7} {'range':>13} {'cpu s':>7} {'by ppo':>7}")
        for row in rows:
            spread = f"{row['ratio_low']:.2f}-{row['ratio_high']:.2f}"
            wall = f"{row['case']:34} {row['seconds']:8.3f} {row['ratio']:7.2f} {spread:>13}"
            print(f"{wall} {row['cpu_seconds']:7.2f} {row['cpu_ratio']:7.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
