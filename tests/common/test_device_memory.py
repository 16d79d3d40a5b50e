"""What processes that may share a GPU are told of its memory, before JAX starts in them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from common.config.settings import RunSettings
from common.config.sources import load
from common.device_memory import ON_DEMAND, require_room, reserve, with_share, worker_environment
from common.errors import SettingsError
from common.numerical_environment import numerical_environment

OTHERS = {"PATH": "/bin"}


def test_by_default_nothing_is_reserved() -> None:
    """JAX alone would take three quarters of the GPU, and the second process would find no room."""
    assert RunSettings().device_memory.learner == RunSettings().device_memory.actor == ON_DEMAND
    assert with_share(OTHERS, ON_DEMAND) == {**OTHERS, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}


@pytest.mark.parametrize(
    "decided",
    [
        {"XLA_PYTHON_CLIENT_PREALLOCATE": "true"},
        {"XLA_CLIENT_MEM_FRACTION": ".5"},
        {"XLA_PYTHON_CLIENT_MEM_FRACTION": ".5"},
    ],
)
def test_on_demand_keeps_what_the_user_decided(decided: dict[str, str]) -> None:
    """Whoever sets JAX's own variables knows why."""
    assert with_share({**OTHERS, **decided}, ON_DEMAND) == {**OTHERS, **decided}


def test_a_share_is_reserved_whatever_the_environment_says() -> None:
    """The former name of the share is taken out, since JAX refuses to start with both."""
    before = {**OTHERS, "XLA_PYTHON_CLIENT_PREALLOCATE": "false", "XLA_PYTHON_CLIENT_MEM_FRACTION": ".9"}
    expected = {**OTHERS, "XLA_PYTHON_CLIENT_PREALLOCATE": "true", "XLA_CLIENT_MEM_FRACTION": "0.25"}
    assert with_share(before, 0.25) == expected


def test_jax_reads_these_variables() -> None:
    """The options that JAX hands to the GPU's plugin, which it makes of the environment when it starts there."""
    words = "import jaxlib.xla_client as x, json; print(json.dumps(x.generate_pjrt_gpu_plugin_options()))"

    def options(environment: dict[str, str]) -> str:
        done = subprocess.run(
            [sys.executable, "-c", words], env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout

    bare = {name: value for name, value in os.environ.items() if not name.startswith("XLA_")}
    assert '"preallocate": false' in options(with_share(bare, ON_DEMAND))
    shared = options(with_share(bare, 0.25))
    assert '"preallocate": true' in shared
    assert '"memory_fraction": 0.25' in shared


@pytest.mark.parametrize("share", [ON_DEMAND, 0.25])
def test_workers_with_the_native_engine_take_no_gpu(share: float) -> None:
    """Whatever their share; those with MJX get theirs, and `auto` may turn out to be MJX."""
    assert worker_environment(OTHERS, "native", share) == {**OTHERS, "JAX_PLATFORMS": "cpu"}
    for physics in ("mjx", "auto"):
        assert worker_environment(OTHERS, physics, share) == with_share(OTHERS, share)


def test_shares_are_read_from_every_notation() -> None:
    """Text, as shells hand it over, and numbers; whatever else is refused with what is allowed."""
    given = {"RESKPN_DEVICE_MEMORY__LEARNER": "0.5", "RESKPN_DEVICE_MEMORY__ACTOR": "on-demand"}
    memory = load(environment=given).device_memory
    assert (memory.learner, memory.actor) == (0.5, ON_DEMAND)
    for wrong in ("0", "1.5", "half", "nan", ""):
        with pytest.raises(SettingsError, match=r"device_memory\.actor.*above 0 and at most 1, or on-demand"):
            load(environment={"RESKPN_DEVICE_MEMORY__ACTOR": wrong})


def test_shares_of_one_gpu_must_fit_in_it() -> None:
    """0.5 + 2 x 0.3 is too much; native actors take none, and whoever takes on demand reserves none."""

    def settings(physics: str, learner: float | str, actor: float | str) -> RunSettings:
        tree = {"physics": physics, "actors": 2, "device_memory": {"learner": learner, "actor": actor}}
        return RunSettings.model_validate(tree)

    with pytest.raises(SettingsError, match=r"learner \(0\.5\).*actor \(0\.3\) of 2 actors make 1\.1 of the GPU"):
        require_room(settings("mjx", 0.5, 0.3))
    for fits in (("native", 0.5, 0.3), ("mjx", 0.4, 0.3), ("auto", ON_DEMAND, 0.5), ("mjx", 1.0, ON_DEMAND)):
        require_room(settings(*fits))


def test_shares_decide_no_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """So a run that is resumed with another share goes on to the same state, and says nothing of it."""
    monkeypatch.setattr(os, "environ", dict(OTHERS))
    reserve(0.5)
    assert os.environ == with_share(OTHERS, 0.5)
    assert numerical_environment(os.environ) == {}
