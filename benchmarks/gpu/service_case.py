"""Speed of a whole run: learner and actors as processes, every rollout logged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.gpu.rows import plan_of, tell
from benchmarks.service import Plan, service

PAPER_STEPS = 5e7
"""Steps of the paper's runs."""


def measure(plan: Mapping[str, Any]) -> None:
    """Tell the one row of this case."""
    sizes = plan["sizes"]
    batch = sizes["num_envs"] * sizes["num_steps"]
    words = ["--config", "paper", *plan["settings"], *options(sizes), "--total-steps", str(plan["updates"] * batch)]
    sample = service(Plan(words, batch, plan["updates"], plan["warm_up"]), plan["actors"], plan["mode"])
    ms = {name: 1e3 * seconds for name, seconds in sample.seconds.items()}
    minutes = PAPER_STEPS / sample.env_steps_per_s / 60
    tell(settings=plan["settings"], mode=plan["mode"], actors=plan["actors"], steps_s=sample.env_steps_per_s, ms=ms,
         minutes_of_paper=minutes)  # fmt: skip


def options(sizes: Mapping[str, Any], prefix: str = "--") -> list[str]:
    """Settings as words of a command line: those in a map are of its section."""
    words: list[str] = []
    for name, value in sizes.items():
        if isinstance(value, Mapping):
            words += options(value, f"{prefix}{name}.")
        else:
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            words += [f"{prefix}{name.replace('_', '-')}", text]
    return words


if __name__ == "__main__":
    measure(plan_of())
