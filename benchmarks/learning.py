"""Compares the learning of this project's PPO and DPO with a separate implementation (`benchmarks.reference`).

    python -m benchmarks.learning --task hopper --learners ppo dpo --steps 1.5e6 --seeds 3 --out build/learning

Every run is a separate process that writes one JSON file to the folder; runs whose files are there are not repeated,
so the command can be stopped and restarted. `summary-<task>.json` contains the results and all curves.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import describe, machine
from benchmarks.processes import run_json
from common.engine_names import PHYSICS
from common.errors import ReskpnError, SettingsError

IMPLEMENTATIONS = ("own", "reference")
MEASURES = {"last tenth": "mean return over the last tenth of the updates", "area": "mean height of the curve"}
RESAMPLES = 10_000


@dataclass(frozen=True)
class Trial:
    """One training run."""

    implementation: str
    task: str
    learner: str
    physics: str
    num_envs: int
    steps: int
    seed: int

    @property
    def file_name(self) -> str:
        return f"{self.task}-{self.learner}-{self.implementation}-s{self.seed}.json"

    def run(self) -> dict[str, Any]:
        """Train in a new process. `return_sum` and `episodes` are per update, of the episodes that ended in it."""
        shared = ["--task", self.task, "--learner", self.learner, "--physics", self.physics]
        shared += ["--num-envs", str(self.num_envs), "--seed", str(self.seed)]
        if self.implementation == "reference":
            return run_json("benchmarks.reference", [*shared, "--steps", str(self.steps)])
        own = ["--config", "paper", "--actors", "1", "--total-steps", str(self.steps), "--warm-up", "1", "--returns"]
        return run_json("benchmarks.one_process", [*shared, *own])


def result_of(trial: Trial, folder: Path) -> dict[str, Any]:
    """The trial's result, read from the folder if it is already there.

    Raises:
        SettingsError: the file there is of a trial with other options.
        ProcessError: the run failed.
    """
    path = folder / trial.file_name
    if path.exists():
        kept: dict[str, Any] = json.loads(path.read_text())
        if kept["trial"] != asdict(trial):
            raise SettingsError(
                f"{path} is of another trial ({kept['trial']}); choose another --out, or move the file away"
            )
        return kept
    made = trial.run() | {"trial": asdict(trial), "machine": machine()}
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(made) + "\n")
    beside.replace(path)
    return made


def curve(result: dict[str, Any]) -> np.ndarray:
    """Mean training return per update [U]; linearly interpolated over updates in which no episode ended.

    Raises:
        SettingsError: no episode ended at all.
    """
    episodes = np.asarray(result["episodes"])
    (known,) = np.nonzero(episodes)
    if not known.size:
        trial = result["trial"]
        raise SettingsError(f"no episode of {trial['task']} ended within {trial['steps']} steps; ask for more --steps")
    means = np.asarray(result["return_sum"])[known] / episodes[known]
    return np.interp(np.arange(len(episodes)), known, means)


def measures(returns: np.ndarray) -> dict[str, float]:
    """The values of `MEASURES` for one curve."""
    late = max(1, len(returns) // 10)
    return {"last tenth": float(returns[-late:].mean()), "area": float(returns.mean())}


def difference_interval(own: Sequence[float], reference: Sequence[float]) -> tuple[float, float] | None:
    """95% bootstrap interval of mean(own) - mean(reference), with seeds resampled independently on each side.

    None of a single seed, which says nothing about others.
    """
    if min(len(own), len(reference)) < 2:
        return None
    random = np.random.default_rng(0)

    def resampled(values: Sequence[float]) -> np.ndarray:
        return random.choice(np.asarray(values), (RESAMPLES, len(values))).mean(axis=1)

    low, high = np.percentile(resampled(own) - resampled(reference), [2.5, 97.5])
    return float(low), float(high)


def compare(own: Sequence[dict[str, Any]], reference: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Values of one learner by measure: per seed on each side, and the difference of the means."""
    found: dict[str, Any] = {}
    for name in MEASURES:
        sides = {
            side: [measures(curve(result))[name] for result in results]
            for side, results in zip(IMPLEMENTATIONS, (own, reference), strict=True)
        }
        difference = float(np.mean(sides["own"]) - np.mean(sides["reference"]))
        interval = difference_interval(sides["own"], sides["reference"])
        found[name] = sides | {"difference": difference, "interval": interval}
    return found


def table(figures: dict[str, Any], seeds: int) -> Iterator[str]:
    """Readable lines with the values by learner."""
    heads = "".join(f"{f'seed {seed}':>10}" for seed in range(seeds))
    yield f"{'':28}{heads}{'mean':>10}"
    for learner, found in figures.items():
        for name, by_side in found.items():
            for side in IMPLEMENTATIONS:
                cells = "".join(f"{value:>10,.1f}" for value in (*by_side[side], float(np.mean(by_side[side]))))
                yield f"{learner:5}{name:12}{side:11}{cells}"
            text = f"{by_side['difference']:+,.1f}"
            if by_side["interval"] is not None:
                text += ", 95% interval {:+,.1f} to {:+,.1f}".format(*by_side["interval"])
            yield f"{learner:5}{name:12}difference {text}"
    yield "; ".join(f"{name}: {text}" for name, text in MEASURES.items())


def main(arguments: Sequence[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    try:
        results = train_all(given)
        figures = {learner: compare(sides["own"], sides["reference"]) for learner, sides in results.items()}
    except ReskpnError as error:
        print(f"learning: {error}", file=sys.stderr)
        return error.exit_code
    every = [result for sides in results.values() for taken in sides.values() for result in taken]
    print(f"{given.task}: {int(given.steps):,} steps, {given.num_envs} environments, {given.seeds} seeds")
    for line in (*describe(every[-1]["machine"]), "", *table(figures, given.seeds)):
        print(line)
    if len(commits := sorted({result["machine"]["commit"] for result in every})) > 1:
        print(f"the results in {given.out} are of more than one commit: {', '.join(commits)}")
    curves = {
        learner: {side: [curve(result).tolist() for result in taken] for side, taken in sides.items()}
        for learner, sides in results.items()
    }
    summary = {"options": vars(given) | {"out": str(given.out)}, "figures": figures, "curves": curves}
    (given.out / f"summary-{given.task}.json").write_text(json.dumps(summary, indent=1) + "\n")
    return 0


def train_all(given: argparse.Namespace) -> dict[str, dict[str, list[dict[str, Any]]]]:
    """The results by learner and implementation, in the order of the seeds. Raises as `result_of` does."""
    if given.seeds < 1:
        raise SettingsError(f"--seeds is {given.seeds}; it must be at least 1")
    given.out.mkdir(parents=True, exist_ok=True)
    results: dict[str, dict[str, list[dict[str, Any]]]] = {
        learner: {side: [] for side in IMPLEMENTATIONS} for learner in given.learners
    }
    for seed in range(given.seeds):
        for learner in given.learners:
            for side in IMPLEMENTATIONS:
                trial = Trial(side, given.task, learner, given.physics, given.num_envs, int(given.steps), seed)
                results[learner][side].append(result_of(trial, given.out))
                print(f"{trial.file_name}: done", file=sys.stderr, flush=True)
    return results


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learning",
        description="Training returns of this project's learners and of a separate implementation, seed by seed.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--task", default="hopper", help="environment")
    parser.add_argument("--learners", nargs="+", default=["ppo", "dpo"], choices=("ppo", "dpo"), help="algorithms")
    parser.add_argument("--physics", default="native", choices=PHYSICS, help="engine of both")
    parser.add_argument("--num-envs", type=int, default=2048, metavar="N", help="environments")
    parser.add_argument("--steps", type=float, default=1.5e6, help="environment steps of a run")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="runs of each kind, seeds 0 to N-1")
    parser.add_argument(
        "--out", type=Path, default=Path("build/learning"), metavar="DIR", help="where results are kept"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
