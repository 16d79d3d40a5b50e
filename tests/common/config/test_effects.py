"""Settings that were changed in vain."""

from __future__ import annotations

from typing import Any

import pytest

from common.config.effects import settings_without_effect
from common.config.settings import RunSettings


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({}, ""),
        ({"learner": "ppo", "rkhs": {"eta": 0.2}}, "rkhs.eta (learner ppo has no RKHS part)"),
        ({"learner": "ppo", "rkhs": {"eta": 0.1}}, ""),  # the default, said aloud
        ({"max_staleness": 3}, "max_staleness (for mode async)"),
        ({"mode": "async", "max_staleness": 3}, ""),
        ({"rkhs": {"kl_target": 0.1}}, "rkhs.kl_target (for rkhs.step trust-region)"),
        ({"rkhs": {"step": "trust-region", "kl_target": 0.1}}, ""),
        ({"rkhs": {"step": "trust-region", "eta": 0.2}}, "rkhs.eta (for rkhs.step fixed)"),
        ({"rkhs": {"slope": 2.0}}, "rkhs.slope (for rkhs.kernel sigmoid)"),
        ({"rkhs": {"kernel": "linear", "bandwidth": 2.0}}, "rkhs.bandwidth (for rkhs.kernel gaussian or laplacian)"),
        ({"rkhs": {"radius": 0.2}}, "rkhs.radius (for rkhs.representation cluster)"),
        ({"rkhs": {"representation": "cluster", "radius": 0.2}}, ""),
        ({"critic": {"ridge": 0.1}}, "critic.ridge (critic.representation is none)"),
        ({"critic": {"representation": "rff", "ridge": 0.1, "capacity": 64}}, ""),
        (
            {"critic": {"representation": "linear", "capacity": 64}},
            "critic.capacity (for critic.representation rff or nystrom)",
        ),
        ({"algorithm": {"dpo_alpha": 3.0}}, "algorithm.dpo_alpha (for the objective dpo)"),
        ({"learner": "dpo", "algorithm": {"dpo_alpha": 3.0}}, ""),
        ({"algorithm": {"objective": "dpo", "dpo_alpha": 3.0}}, ""),
        ({"transport": {"actor_names": "bob"}}, "transport.actor_names (without certificates or users)"),
        ({"transport": {"actor_names": "bob", "users": "file"}}, ""),
    ],
)
def test_what_has_no_effect_is_named_with_its_reason(values: dict[str, Any], named: str) -> None:
    """Where the value is not the default: a setting that is left alone is no surprise."""
    expected = f"settings without effect in this run: {named}" if named else ""
    assert settings_without_effect(RunSettings.model_validate(values)) == expected


def test_several_are_in_one_line() -> None:
    """In the order of the run."""
    settings = RunSettings.model_validate({"max_staleness": 2, "learner": "ppo", "rkhs": {"eta": 1.0, "clip": 2.0}})
    assert settings_without_effect(settings) == (
        "settings without effect in this run: max_staleness (for mode async), "
        "rkhs.eta (learner ppo has no RKHS part), rkhs.clip (learner ppo has no RKHS part)"
    )
