"""The default preset: sizes for every learner, kernel parts for its own; other presets replace all of it."""

from __future__ import annotations

import pytest

from common.config.presets import PRESETS, default_settings, default_values, read_preset
from common.config.settings import RkhsSettings, RunSettings
from common.config.sources import from_values, load
from common.errors import SettingsError
from common.learners import LEARNERS


def test_the_default_has_both_kernel_parts() -> None:
    """ResKPN with batches of 64 x 128 = 8,192 in 32 minibatches of 256."""
    settings = default_settings()
    assert (settings.learner, settings.batch_size, settings.algorithm.minibatches) == ("reskpn", 8192, 32)
    assert (settings.rkhs.step, settings.critic.representation) == ("trust-region", "rff")


@pytest.mark.parametrize("learner", [name for name in LEARNERS if name != "reskpn"])
def test_another_learner_is_its_plain_self(learner: str) -> None:
    """Sizes of the default preset; no kernel critic, the paper's kernel step, and the learner's own objective."""
    settings = load(environment={"RESKPN_LEARNER": learner})
    assert (settings.learner, settings.num_envs, settings.algorithm.hidden) == (learner, 64, (128, 128))
    assert (settings.critic.representation, settings.algorithm.objective) == ("none", "auto")
    assert settings.rkhs == RkhsSettings()


def test_its_learner_may_be_named() -> None:
    assert load(environment={"RESKPN_LEARNER": "reskpn"}) == default_settings()
    assert from_values({"learner": "reskpn"}) == default_settings()


def test_an_unknown_learner_is_refused_as_such() -> None:
    with pytest.raises(SettingsError, match="learner"):
        load(environment={"RESKPN_LEARNER": "reskpm"})


def test_the_preset_paper_leaves_nothing_of_the_default() -> None:
    """Every setting that the default preset changes is set in the paper's, too."""
    assert load(config="paper", environment={}) == RunSettings.model_validate(read_preset("paper"))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_can_be_named(name: str) -> None:
    assert load(config=name, environment={}).learner == default_values()["learner"]


def test_values_of_a_call_take_precedence() -> None:
    """`reskpn.train(task=..., algorithm={...})`: maps are merged over the preset's."""
    settings = from_values({"task": "hopper", "algorithm": {"gamma": 0.5}})
    assert (settings.task, settings.algorithm.gamma, settings.algorithm.hidden) == ("hopper", 0.5, (128, 128))
    with pytest.raises(SettingsError, match="from the call"):
        from_values({"algorithm": {"gamma": 5}})
