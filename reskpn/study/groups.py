"""The results of an experiment by arm and task: what figures and tables are made from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from common.errors import SettingsError
from reskpn.study.experiments import Experiment
from reskpn.study.planning import Plan
from reskpn.study.results import NO_EPISODE_ENDS, Result
from reskpn.study.statistics import Strata
from reskpn.study.store import Store

COMPARABLE = ("jax", "jaxlib", "mujoco", "brax", "flax", "optax")
"""Packages whose versions the results of one comparison must share."""


@dataclass(frozen=True)
class Group:
    """The runs of one arm by task, in the order of seeds."""

    name: str
    label: str
    results: Mapping[str, list[Result]]

    def scores(self, score: Callable[[Result], float]) -> Strata:
        """A score of every run by task, tasks without runs left out."""
        return {task: np.array([score(r) for r in runs]) for task, runs in self.results.items() if runs}


def group(experiment: Experiment, plan: Plan, store: Store) -> list[Group]:
    """The groups of an experiment, in the order of its arms and tasks, out of the results that there are.

    Raises:
        SettingsError: results were made with different versions of what computes them.
    """
    by_arm: dict[str, dict[str, list[Result]]] = {name: {} for name in experiment.arms}
    for trial in plan.trials:
        runs = by_arm[trial.arm].setdefault(trial.settings.task, [])
        if (result := store.find(trial.settings)) is not None:
            runs.append(result)
    groups = [Group(name, experiment.arms[name].label or name, runs) for name, runs in by_arm.items()]
    refuse_mixed_versions(groups, f"the results of {experiment.name}")
    return groups


def refuse_mixed_versions(groups: Iterable[Group], what: str) -> None:
    """SettingsError where results were made with different versions of what computes them."""
    found: dict[tuple[tuple[str, str], ...], int] = {}
    for each in groups:
        for runs in each.results.values():
            for result in runs:
                versions = tuple((name, result.versions.get(name, "unknown")) for name in COMPARABLE)
                found[versions] = found.get(versions, 0) + 1
    if len(found) < 2:
        return
    first, second = sorted(found, key=lambda versions: -found[versions])[:2]
    differing = [(name, a, b) for (name, a), (_, b) in zip(first, second, strict=True) if a != b]
    name, one, other = differing[0]
    raise SettingsError(
        f"{what} are of different versions: {found[first]} runs with {name} {one}, {found[second]} with {other}; move "
        "the result files of one version away, or keep them in folders of their own (--results)"
    )


def starting_score(groups: Iterable[Group]) -> dict[str, float]:
    """By task, the mean score of a policy at the start of training: of the first point of all runs' curves."""
    starts: dict[str, list[float]] = {}
    for each in groups:
        for task, runs in each.results.items():
            for result in runs:
                points = series(result, "return")[1]
                starts.setdefault(task, []).append(float(points[0]))
    return {task: float(np.mean(values)) for task, values in starts.items()}


def series(result: Result, measure: str) -> tuple[np.ndarray, np.ndarray]:
    """Environment steps and values of one column of a run's curve, where it has values; both may be empty.

    `return` is, on tasks where no episode terminates, the mean reward of a step times the length of an episode.
    """
    columns = result.curve
    factor = 1.0
    if measure == "return" and result.task in NO_EPISODE_ENDS:
        measure, factor = "reward", float(result.settings["episode_length"])
    steps, values = columns["env_steps"], columns.get(measure, [])
    pairs = [(step, value) for step, value in zip(steps, values, strict=False) if value is not None]
    if not pairs:
        return np.zeros(0), np.zeros(0)
    x, y = np.array(pairs, np.float64).T
    return x, factor * y
