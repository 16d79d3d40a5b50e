"""Presets: settings by name, as YAML files of this package; `default` is what a run has where nothing else is said."""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

import yaml

from common.config.settings import RunSettings
from common.learners import LEARNERS

PRESETS = ("default", "paper")

OF_A_LEARNER = ("critic", "rkhs")
"""Sections of the default preset that hold for its own learner only: another one has its baseline's plain form."""


def read_preset(name: str) -> dict[str, Any]:
    """The settings of a preset, in the shape of the tree."""
    values = yaml.safe_load(resources.files("reskpn").joinpath(f"presets/{name}.yaml").read_text())
    assert isinstance(values, dict)
    return values


def default_values(learner: str | None = None) -> dict[str, Any]:
    """The settings of a run of which nothing is said but, perhaps, the learner.

    Sizes are the same for all learners. Kernel step, kernel critic and objective are those of the default preset for
    its own learner; with another they are off, or that learner's own.
    """
    values = read_preset("default")
    if learner in (None, values["learner"]) or learner not in LEARNERS:
        return values
    kept = {name: value for name, value in values.items() if name not in OF_A_LEARNER}
    kept["algorithm"] = {name: value for name, value in kept["algorithm"].items() if name != "objective"}
    return kept | {"learner": learner}


@cache
def default_settings() -> RunSettings:
    """The settings of a run of which nothing is said."""
    return RunSettings.model_validate(default_values())
