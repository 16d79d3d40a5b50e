"""Experiments as small declarative files: tasks x arms x seeds at a scale, and how to draw what comes of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from common.config.kinds import Count, Section
from common.errors import SettingsError
from common.learners import LEARNERS
from common.suggestions import unknown_name
from common.tasks import task_fault

SCALES = ("smoke", "laptop", "full")

Base = Literal["paper", "default"]
"""The preset below all other settings; of `default`, what holds for the arm's learner."""

Values = dict[str, Any]
"""Settings by dotted name, `algorithm.gamma: 0.99`."""


class BestOf(Section):
    """The arm of another experiment with the highest mean score over its tasks, each task in units of its best arm."""

    experiment: str
    arms: tuple[str, ...] = Field(min_length=1)


class Arm(Section):
    """One side of a comparison.

    Attributes:
        base: None for that of the experiment.
        learner: None for that of the experiment's settings, or of the chosen arm.
        settings: over those of the experiment.
        best_of: take learner and settings from the results of another experiment.
        width_of: set rkhs.bandwidth to the ratio of the mean variances of observations and features in the results of
            that experiment's first arm (the paper's sigma*, section 4.3).
    """

    base: Base | None = None
    learner: str | None = None
    label: str = ""
    settings: Values = Field(default_factory=dict)
    best_of: BestOf | None = None
    width_of: str | None = None

    @field_validator("learner")
    @classmethod
    def _known_learner(cls, learner: str | None) -> str | None:
        if learner is not None and learner not in LEARNERS:
            raise ValueError(unknown_name("learner", learner, LEARNERS))
        return learner


class Drawing(Section):
    """A figure or table of an experiment.

    Attributes:
        kind: curves (by environment step), spreads (quantiles by dimension), scores, runtimes or settings (tables).
        measures: columns of the curves; with more than one, each is a line of its own and arms are panels.
        scale: of the vertical axis.
        reference: arm that has 1 in normalised scores; the first by default.
    """

    kind: Literal["curves", "spreads", "scores", "runtimes", "settings"]
    measures: tuple[str, ...] = ("return",)
    scale: Literal["linear", "log"] = "linear"
    reference: str | None = None


class ScaleOverride(Section):
    """The values in which an experiment departs from its scale, and the arms that it has there; None for all."""

    steps: Count | None = None
    seeds: Count | None = None
    tasks: tuple[str, ...] | None = None
    arms: tuple[str, ...] | None = None


class Experiment(Section):
    """One figure, table or study. The same run in two experiments is made once."""

    name: str
    paper: str = ""
    title: str
    base: Base = "paper"
    tasks: tuple[str, ...] = Field(min_length=1)
    arms: dict[str, Arm]
    settings: Values = Field(default_factory=dict)
    drawing: Drawing
    scales: dict[str, ScaleOverride] = Field(default_factory=dict)

    @field_validator("tasks")
    @classmethod
    def _known_tasks(cls, tasks: tuple[str, ...]) -> tuple[str, ...]:
        for task in tasks:
            if (fault := task_fault(task, None)) is not None:
                raise ValueError(fault)
        return tasks

    @field_validator("scales")
    @classmethod
    def _known_scales(cls, scales: dict[str, ScaleOverride]) -> dict[str, ScaleOverride]:
        for name in scales:
            if name not in SCALES:
                raise ValueError(unknown_name("scale", name, SCALES))
        return scales

    @model_validator(mode="after")
    def _needs_arms(self) -> Self:
        if not self.arms and self.drawing.kind != "settings":
            raise ValueError("needs at least one arm, for example 'dpo: {learner: dpo}'")
        for override in self.scales.values():
            for arm in override.arms or ():
                if arm not in self.arms:
                    raise ValueError(unknown_name("arm", arm, self.arms))
        return self

    @property
    def needs_runs(self) -> bool:
        """True if it is drawn from results; a table of settings is not."""
        return self.drawing.kind != "settings"

    @property
    def needs(self) -> set[str]:
        """Experiments whose results decide settings of this one."""
        chosen = {arm.best_of.experiment for arm in self.arms.values() if arm.best_of}
        return chosen | {arm.width_of for arm in self.arms.values() if arm.width_of}


class Scale(Section):
    """The size of the runs of all experiments.

    Attributes:
        steps: environment steps of a run, and `steps_of` those on some tasks instead.
        tasks: the first so many tasks of an experiment; None for all.
        settings: over those of experiments and arms.
    """

    steps: Count
    steps_of: dict[str, Count] = Field(default_factory=dict)
    seeds: Count
    tasks: Count | None = None
    settings: Values = Field(default_factory=dict)


def load_scale(name: str) -> Scale:
    """A scale by name; SettingsError for one that does not exist."""
    if name not in SCALES:
        raise SettingsError(unknown_name("scale", name, SCALES))
    text = resources.files("reskpn.study").joinpath("scales.yaml").read_text()
    return Scale.model_validate(yaml.safe_load(text)[name])


def load_catalogue() -> dict[str, Experiment]:
    """The experiments of this package by name, in the paper's order."""
    folder = resources.files("reskpn.study").joinpath("catalogue")
    files = [file for file in folder.iterdir() if file.name.endswith(".yaml")]
    found = [parse_experiment(file.name.removesuffix(".yaml"), file.read_text()) for file in files]
    return {experiment.name: experiment for experiment in sorted(found, key=_order)}


def read_experiment(path: Path) -> Experiment:
    """An experiment out of a file; SettingsError where it cannot be read or is not one."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SettingsError(f"{path} cannot be read ({error.strerror}); give the file of an experiment") from None
    except UnicodeDecodeError:
        raise SettingsError(f"{path} is not a text file; give a YAML file of an experiment") from None
    return parse_experiment(path.stem, text, str(path))


def parse_experiment(name: str, text: str, source: str = "") -> Experiment:
    """An experiment out of YAML; SettingsError with one sentence for the first fault."""
    source = source or f"experiment {name}"
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise SettingsError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(values, Mapping):
        raise SettingsError(f"{source}: must be a mapping with title, tasks, arms and drawing")
    try:
        return Experiment.model_validate({"name": name, **values})
    except ValidationError as error:
        raise SettingsError(f"{source}: {first_fault(error, Experiment.model_fields)}") from None


def first_fault(error: ValidationError, allowed: Iterable[str]) -> str:
    """One sentence on the first fault that validation found. `allowed`: the names at the top."""
    fault = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(str(part) for part in fault["loc"])
    if fault["type"] == "extra_forbidden":
        names = list(allowed) if len(fault["loc"]) == 1 else []
        return unknown_name("entry", where, names) if names else f"{where}: there is no such entry; remove it"
    return f"{where}: {fault['msg'].removeprefix('Value error, ')}" if where else str(fault["msg"])


def _order(experiment: Experiment) -> tuple[int, int, str]:
    """Figures, then tables, then the studies that the paper does not have; by number."""
    kind, _, number = experiment.paper.partition(" ")
    digits = "".join(sign for sign in number if sign.isdecimal())
    return ("Figure", "Table", "").index(kind), int(digits or 0), experiment.name
