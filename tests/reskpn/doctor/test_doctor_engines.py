"""Checks of JAX and the engines."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import pytest

import common.physics.environments
from common.config.settings import RunSettings
from common.errors import PhysicsError
from reskpn.doctor.engines import STEPPED, check_jax, check_mjx, check_native, state_sizes, step_once
from reskpn.doctor.findings import guarded


def test_jax_is_there() -> None:
    """With its version and devices."""
    found = check_jax()
    assert found.level == "ok"
    assert found.figures["devices"] >= 1


def test_the_native_engine_takes_a_step() -> None:
    """A real one."""
    found = check_native()
    assert found.level == "ok"
    assert found.text.startswith("steps inverted_pendulum (first step ")


def test_mjx_is_imported_and_not_compiled() -> None:
    """Unless it is asked for."""
    assert check_mjx(full=False).text == "mujoco.mjx can be imported; --full also compiles a step"


@pytest.mark.parametrize("after", [0.0, float("nan"), 1e30])
def test_an_engine_that_does_not_move_as_it_should(monkeypatch: pytest.MonkeyPatch, after: float) -> None:
    """Nothing moved, not a number, or out of this world: a problem, whichever it is."""

    def make(*_: Any, **__: Any) -> Any:
        state = SimpleNamespace(obs=jnp.zeros((STEPPED, 4)))
        moved = SimpleNamespace(obs=jnp.full((STEPPED, 4), after))
        return SimpleNamespace(reset=lambda key: state, step=lambda state, action: (moved, None))

    monkeypatch.setattr(common.physics.environments, "make_environment", make)
    with pytest.raises(PhysicsError, match="physics 'native' gives no plausible motion"):
        step_once("native")
    assert guarded("native", check_native).level == "problem"


def test_sizes_of_policy_and_state() -> None:
    """PPO with one hidden layer of 2 on O = 4, A = 1: at the least the weights, and Adam's two moments of each."""
    given = RunSettings.model_validate({"learner": "ppo", "algorithm": {"hidden": (2,)}})
    policy, state = state_sizes(given)
    # A layer of 4 x 2 + 2, and its mean of 2 x 1 + 1.
    assert policy >= 4 * (4 * 2 + 2 + 2 * 1 + 1)
    assert state >= 3 * 4 * (4 * 2 + 2 + 2 * 1 + 1)
