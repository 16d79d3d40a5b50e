"""Settings of the kernel critic: what cannot go together is refused with a sentence."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from common.config.settings import RunSettings


def settings(**changes: Any) -> RunSettings:
    """A run of 2 environments by 8 steps with a kernel critic of so many changes."""
    shape = {"num_envs": 2, "num_steps": 8, "actors": 1, "algorithm": {"minibatches": 1}} | changes.pop("shape", {})
    return RunSettings.model_validate({**shape, "critic": changes})


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"representation": "rff", "capacity": 5}, r"critic\.capacity \(5\) must be even"),
        ({"representation": "nystrom", "capacity": 17}, r"critic\.capacity \(17\) must be at most the batch of 16"),
        ({"representation": "nystrom", "capacity": 4, "forgetting": 0.5}, "choose critic.representation rff or linear"),
        ({"representation": "linear", "shape": {"num_envs": 1}}, "needs num_envs of at least 2"),
        ({"representation": "exact"}, "Input should be 'none', 'rff', 'nystrom' or 'linear'"),
        ({"ridge": 0}, "greater than 0"),
        ({"forgetting": 1}, "less than 1"),
    ],
)
def test_what_no_run_could_do_is_refused(changes: dict[str, Any], sentence: str) -> None:
    """The error names the setting, what was given and what is possible."""
    with pytest.raises(ValidationError, match=sentence):
        settings(**changes)


@pytest.mark.parametrize("representation", ["none", "rff", "nystrom", "linear"])
def test_all_that_can_be_named_can_run(representation: str) -> None:
    """Each of them with a capacity that fits the batch."""
    assert settings(representation=representation, capacity=16).critic.representation == representation


def test_without_a_kernel_critic_its_other_settings_exclude_nothing() -> None:
    """Switched off, an odd capacity and a single environment are allowed."""
    assert settings(capacity=3, shape={"num_envs": 1}).critic.representation == "none"
