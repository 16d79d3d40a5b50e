"""The zoo's settings are read as it means them, without running what it says."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.peers.environment import pins
from benchmarks.peers.zoo import call_arguments, newest
from common.errors import SettingsError

ENTRY: dict[str, Any] = {"normalize": True, "policy": "MlpPolicy", "n_steps": 512, "gamma": 0.999}


def test_the_newest_version_of_an_environment_counts() -> None:
    """Asked for Hopper-v5, the zoo has 2 and 4; HopperBulletEnv is another environment."""
    zoo = {"Hopper-v2": {"n_steps": 1}, "Hopper-v4": ENTRY, "HopperBulletEnv-v9": {"n_steps": 2}}
    assert newest(zoo, "Hopper-v5") == ENTRY | {"entry": "Hopper-v4", "policy_kwargs": {}}


def test_arguments_of_a_policy_are_read_from_their_text() -> None:
    text = "dict(log_std_init=-2, ortho_init=False,\n activation_fn=nn.ReLU, net_arch=dict(pi=[256, 256], vf=[64]))"
    assert call_arguments(text) == {
        "log_std_init": -2,
        "ortho_init": False,
        "activation_fn": "ReLU",
        "net_arch": {"pi": [256, 256], "vf": [64]},
    }


@pytest.mark.parametrize("text", ["print(1)", "[1, 2]"])
def test_a_policy_that_is_no_dict_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match=r"must be a dict\(...\)"):
        call_arguments(text)


@pytest.mark.parametrize(
    ("zoo", "said"),
    [
        ({"Walker2d-v4": ENTRY}, "recommends no settings of PPO for Hopper"),
        ({"Hopper-v4": ENTRY | {"use_sde": True}}, "Hopper-v4 have use_sde"),
        ({"Hopper-v4": ENTRY | {"learning_rate": "lin_3e-4"}}, "Hopper-v4 have learning_rate"),
    ],
)
def test_what_cannot_be_applied_is_refused(zoo: dict[str, Any], said: str) -> None:
    """A run of a shortened or foreign recipe would not be the peer's own."""
    with pytest.raises(SettingsError, match=said):
        newest(zoo, "Hopper-v5")


def test_every_package_of_the_peers_is_pinned() -> None:
    """Those that decide a result, each with a version."""
    found = pins("stable-baselines3", "sbx-rl", "torch", "rl-zoo3", "gymnasium", "mujoco", "jax")
    assert all(version[0].isdigit() for version in found.values())
