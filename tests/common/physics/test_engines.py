"""Which engine a name stands for, and how JAX has to run for it."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import pytest

from common.errors import PhysicsError, SettingsError
from common.physics import engines
from common.physics.engines import require_synchronous_dispatch, resolve_physics

ASYNCHRONOUS = "jax_cpu_enable_async_dispatch"


@pytest.fixture
def asynchronous() -> Iterator[None]:
    """JAX as it is by default, for one test."""
    before = jax.config.read(ASYNCHRONOUS)
    jax.config.update(ASYNCHRONOUS, True)
    yield
    jax.config.update(ASYNCHRONOUS, before)


@pytest.mark.parametrize(("backend", "engine"), [("cpu", "native"), ("gpu", "mjx"), ("tpu", "mjx")])
def test_auto_is_native_on_a_cpu_and_mjx_on_an_accelerator(
    backend: str, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ "auto" is the engine that is fast where JAX runs."""
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    assert resolve_physics("auto") == engine


@pytest.mark.parametrize("name", ["mjx", "native"])
def test_a_named_engine_is_taken_whatever_the_machine(name: str) -> None:
    """A user who names an engine gets that engine."""
    assert resolve_physics(name) == name


def test_an_unknown_engine_is_refused_with_the_names_there_are() -> None:
    """The message repeats what was given, guesses what was meant and lists what is allowed."""
    with pytest.raises(SettingsError, match=r"'nativ' is not a physics engine.*'native'.*auto, mjx, native"):
        resolve_physics("nativ")


@pytest.mark.usefixtures("asynchronous")
def test_jax_that_has_not_started_is_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before JAX is used, asynchronous dispatch is turned off and nothing is asked of the user."""
    monkeypatch.setattr(engines, "backends_are_initialized", lambda: False)
    require_synchronous_dispatch()
    assert jax.config.read(ASYNCHRONOUS) is False


@pytest.mark.usefixtures("asynchronous")
def test_auto_prepares_jax_before_it_starts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Asking JAX for its backend starts it, so "auto" turns asynchronous dispatch off before it asks."""
    monkeypatch.setattr(engines, "backends_are_initialized", lambda: False)
    seen = []
    monkeypatch.setattr(jax, "default_backend", lambda: seen.append(jax.config.read(ASYNCHRONOUS)) or "cpu")
    resolve_physics("auto")
    assert seen == [False]


@pytest.mark.usefixtures("asynchronous")
def test_jax_that_started_otherwise_is_refused_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where calls to the native engine could hang, there is an error before the first of them."""
    monkeypatch.setattr(engines, "backends_are_initialized", lambda: True)
    with pytest.raises(PhysicsError, match=r"require_synchronous_dispatch\(\).*JAX_CPU_ENABLE_ASYNC_DISPATCH=0"):
        require_synchronous_dispatch()
