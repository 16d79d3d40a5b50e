"""What is measured, in order of importance: each case is a process of its own, bounded in time."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Literal

from common.engine_names import MJX, NATIVE

Kind = Literal["physics", "update", "service"]

WARP = "warp"
"""MJX's implementation in Warp, which only a measurement here asks for."""

CENTRES = 2441
"""Centres of the paper's runs: one for each update of 5e7 steps in batches of 20,480."""


@dataclass(frozen=True)
class Scale:
    """How large the cases are.

    Attributes:
        sizes: settings of the runs and updates.
        steps, repeats: of a rollout of physics alone, and rollouts.
        rounds: updates of each kind, after one for warm-up.
        updates, warm_up: of a run of the service, and how many of them are not measured.
        environment: variables for all processes.
        patience: factor of the time limits of all cases.
    """

    name: str
    sizes: dict[str, Any]
    steps: int
    repeats: int
    rounds: int
    updates: int
    warm_up: int
    environment: dict[str, str] = field(default_factory=dict)
    patience: float = 1.0


FULL = Scale("full", {"num_envs": 2048, "num_steps": 10}, steps=10, repeats=10, rounds=20, updates=80, warm_up=20)
"""The sizes of the paper's Table 1."""

SMALL = Scale(
    "small",
    {"num_envs": 16, "num_steps": 5, "algorithm": {"hidden": [16, 16], "minibatches": 4, "epochs": 1}},
    steps=2,
    repeats=1,
    rounds=1,
    updates=3,
    warm_up=1,
    environment={"JAX_DISABLE_MOST_OPTIMIZATIONS": "1"},
    patience=5.0,
)
"""So small that every case runs on a CPU in a few seconds: whether they run, not how fast."""


@dataclass(frozen=True)
class Case:
    """One process.

    Attributes:
        name: unique; what the report calls it.
        kind: the module `benchmarks.gpu.<kind>_case` measures it.
        plan: what that module is told, as JSON, beside the scale.
        limit_s: after which it is stopped.
        on_cpu: JAX is kept off the GPU in this process and those that it starts.
    """

    name: str
    kind: Kind
    plan: dict[str, Any]
    limit_s: float
    on_cpu: bool = False

    def words(self, scale: Scale) -> list[str]:
        """The command line of its process, after the interpreter."""
        sizes = {"sizes": scale.sizes, "steps": scale.steps, "repeats": scale.repeats, "rounds": scale.rounds}
        runs = {"updates": scale.updates, "warm_up": scale.warm_up}
        return ["-m", f"benchmarks.gpu.{self.kind}_case", json.dumps({**self.plan, **sizes, **runs})]


def cases() -> list[Case]:
    """All of them; those at the end are what a slow machine does without."""
    found = [update("humanoid", 110)]
    for task in ("humanoid", "hopper"):
        found += [service(task, NATIVE, "n=1", 80), service(task, MJX, "n=1", 100), physics(task, NATIVE, 40)]
        found += [physics(task, MJX, 80)]
    found += [update("hopper", 90)]
    found += [service("humanoid", MJX, variant, 80) for variant in ("ppo", "n=5", "whole batch")]
    found += [physics(task, WARP, 90) for task in ("humanoid", "hopper")]
    return [*found, whole("humanoid", 60)]


def physics(task: str, engine: str, limit_s: float) -> Case:
    """Physics with random actions, without policy, update or messages."""
    plan = {"task": task, "engine": engine}
    return Case(f"physics {task} {engine}", "physics", plan, limit_s, on_cpu=engine == NATIVE)


def update(task: str, limit_s: float) -> Case:
    """Updates of random transitions: every learner in TF32, then the two of the paper in bfloat16 and float32."""
    return Case(f"update {task}", "update", {"task": task, "which": "usual"}, limit_s)


def whole(task: str, limit_s: float) -> Case:
    """An update that makes every transition of the batch a centre."""
    return Case(f"update {task} all centres", "update", {"task": task, "which": "whole"}, limit_s)


VARIANTS: dict[str, list[str]] = {
    "ppo": ["--learner", "ppo"],
    "n=1": ["--learner", "reskpn", "--rkhs.capacity", str(CENTRES)],
    "n=5": ["--learner", "reskpn", "--rkhs.samples", "5", "--rkhs.capacity", str(CENTRES)],
    "whole batch": [
        *("--learner", "reskpn", "--rkhs.representation", "rff", "--rkhs.samples", "batch"),
        *("--rkhs.capacity", "256", "--rkhs.step", "trust-region"),
    ],
}
"""Learners of a run, by their names in the report; n is the number of transitions of a functional gradient."""


def service(task: str, engine: str, variant: str, limit_s: float) -> Case:
    """A run of the service: async with native actors on the CPU, or with one MJX actor on the learner's device."""
    async_ = engine == NATIVE
    settings = ["--task", task, "--physics", engine, *VARIANTS[variant]]
    plan = {"settings": settings, "actors": 2 if async_ else 1, "mode": "async" if async_ else "sync"}
    return Case(f"service {task} {engine} {variant}", "service", plan, limit_s)
