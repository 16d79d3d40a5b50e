"""The runs that an experiment needs at a scale: those of its arms on its tasks, seed by seed."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from common.config.settings import RunSettings
from common.config.sources import from_values, load
from common.errors import SettingsError
from common.suggestions import unknown_name
from reskpn.study.experiments import Arm, Base, BestOf, Experiment, Scale, ScaleOverride, Values, load_scale
from reskpn.study.results import Result, identity
from reskpn.study.scoring import area_of
from reskpn.study.store import Store


@dataclass(frozen=True)
class Trial:
    """One run that an experiment needs."""

    experiment: str
    arm: str
    settings: RunSettings

    @property
    def identity(self) -> str:
        return identity(self.settings)

    def __str__(self) -> str:
        return f"{self.arm} on {self.settings.task}, seed {self.settings.seed}"


@dataclass(frozen=True)
class Plan:
    """The trials of an experiment, seed by seed, and the arms whose settings other results have yet to decide."""

    trials: list[Trial]
    undecided: dict[str, str]


def plan(experiment: Experiment, scale_name: str, catalogue: Mapping[str, Experiment], store: Store) -> Plan:
    """All trials of an experiment at a scale.

    Raises:
        SettingsError: a setting of it is unknown or not possible, or it names an experiment that does not exist.
    """
    scale = load_scale(scale_name)
    override = experiment.scales.get(scale_name, ScaleOverride())
    tasks = override.tasks or experiment.tasks[: scale.tasks]
    chosen: dict[str, Values | None] = {
        name: _chosen(experiment, arm, scale_name, catalogue, store)
        for name, arm in experiment.arms.items()
        if override.arms is None or name in override.arms
    }
    trials = [
        Trial(experiment.name, name, _settings(experiment, name, values, task, seed, scale, override))
        for seed in range(override.seeds or scale.seeds)
        for task in tasks
        for name, values in chosen.items()
        if values is not None
    ]
    waiting = {name: _needed(experiment.arms[name]) for name, values in chosen.items() if values is None}
    return Plan(trials, waiting)


def with_needs(names: list[str], catalogue: Mapping[str, Experiment]) -> list[Experiment]:
    """The experiments of these names, each after those whose results it needs; SettingsError for an unknown name."""
    ordered: dict[str, Experiment] = {}

    def add(name: str) -> None:
        if name not in catalogue:
            raise SettingsError(unknown_name("experiment", name, catalogue))
        for needed in sorted(catalogue[name].needs):
            if needed not in ordered:
                add(needed)
        ordered[name] = catalogue[name]

    for name in names:
        add(name)
    return list(ordered.values())


def _needed(arm: Arm) -> str:
    return arm.best_of.experiment if arm.best_of else str(arm.width_of)


def _chosen(
    experiment: Experiment, arm: Arm, scale: str, catalogue: Mapping[str, Experiment], store: Store
) -> Values | None:
    """The settings of an arm over those of its experiment; None while the results that decide them are missing."""
    own: Values = ({"learner": arm.learner} if arm.learner else {}) | arm.settings
    if arm.best_of is None and arm.width_of is None:
        return own
    needed = _needed(arm)
    if needed not in catalogue:
        raise SettingsError(f"experiment {experiment.name}: {unknown_name('experiment', needed, catalogue)}")
    other = catalogue[needed]
    others = plan(other, scale, catalogue, store)
    results = {trial: store.find(trial.settings) for trial in others.trials}
    if others.undecided or any(result is None for result in results.values()):
        return None
    found = {trial: result for trial, result in results.items() if result is not None}
    if arm.best_of:
        best = other.arms[best_arm(arm.best_of, found)]
        return ({"learner": best.learner} if best.learner else {}) | best.settings | own
    return own | {"rkhs.bandwidth": width(found, next(iter(other.arms)))}


def best_arm(best_of: BestOf, results: Mapping[Trial, Result]) -> str:
    """The arm with the highest mean area over the tasks, each in units of the task's highest mean over these arms."""
    tasks = {trial.settings.task for trial in results}
    means = {
        (arm, task): np.mean([area_of(r) for t, r in results.items() if t.arm == arm and t.settings.task == task])
        for arm in best_of.arms
        for task in tasks
    }
    spans = {task: max(abs(means[arm, task]) for arm in best_of.arms) or 1.0 for task in tasks}
    return max(best_of.arms, key=lambda arm: float(np.mean([means[arm, task] / spans[task] for task in tasks])))


def width(results: Mapping[Trial, Result], arm: str) -> float:
    """sigma*^2 = mean(var_obs) / mean(var_rep) (paper, section 4.3), over the seeds of an arm, to 3 digits."""
    pairs = np.array([r.spreads["mean_variance"][0] for t, r in results.items() if t.arm == arm])
    observations, features = pairs.mean(axis=0)
    return float(f"{observations / features:.3g}")


def _settings(
    experiment: Experiment, arm: str, values: Values, task: str, seed: int, scale: Scale, override: ScaleOverride
) -> RunSettings:
    """The settings of one run: preset, experiment, arm and scale, each over the one before."""
    steps = override.steps or scale.steps_of.get(task, scale.steps)
    given = experiment.settings | values | scale.settings
    tree = _base(experiment.arms[arm].base or experiment.base, given.get("learner")).model_dump()
    for name, value in given.items():
        _set(tree, name, value, f"experiment {experiment.name}, arm {arm}")
    tree |= {"task": task, "seed": seed, "total_steps": steps, "actors": 1}
    try:
        return RunSettings.model_validate(tree)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_context=False)[0]
        name = ".".join(str(part) for part in fault["loc"])
        text = fault["msg"].removeprefix("Value error, ")
        raise SettingsError(f"experiment {experiment.name}, arm {arm}: {name + ': ' if name else ''}{text}") from None


@functools.cache
def _base(name: Base, learner: str | None) -> RunSettings:
    if name == "paper":
        return load(config=name, environment={})
    return from_values({} if learner is None else {"learner": learner})


def _set(tree: dict[str, Any], name: str, value: Any, where: str) -> None:
    """Set a dotted name in a tree of settings; SettingsError for one that is not there."""
    *sections, last = name.split(".")
    node = tree
    for section in sections:
        inner = node.get(section)
        if not isinstance(inner, dict):
            raise SettingsError(f"{where}: {unknown_name('setting', name, _names(tree))}")
        node = inner
    if last not in node:
        raise SettingsError(f"{where}: {unknown_name('setting', name, _names(tree))}")
    node[last] = value


def _names(tree: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Dotted names of all settings of a tree."""
    names: list[str] = []
    for name, value in tree.items():
        names += _names(value, f"{prefix}{name}.") if isinstance(value, dict) else [prefix + name]
    return names
