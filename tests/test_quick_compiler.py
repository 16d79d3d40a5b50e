"""What is compiled in a hurry, and what is not."""

from __future__ import annotations

from typing import Any

import jax
import pytest
from jax._src import compiler
from quick_compiler import OPTIONS, forget_programs, quick_compiler


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[dict[str, Any] | None, bool]]:
    """What every program is compiled with from now on: options, and whether most optimisations are left out."""
    found: list[tuple[dict[str, Any] | None, bool]] = []
    options_of = compiler.get_compile_options

    def watched(*args: Any, env_options_overrides: dict[str, Any] | None = None, **kwargs: Any) -> Any:
        found.append((env_options_overrides or None, jax.config.read("jax_disable_most_optimizations")))
        return options_of(*args, env_options_overrides=env_options_overrides, **kwargs)

    monkeypatch.setattr(compiler, "get_compile_options", watched)
    return found


def test_programs_inside_alone_are_compiled_in_a_hurry(asked: list[Any]) -> None:
    """With the options for that, and without most optimisations; before and after with JAX's own settings."""
    number = jax.device_put(1.0)
    jax.jit(lambda x: x + 1.0)(number)
    with quick_compiler():
        jax.jit(lambda x: x + 2.0)(number)
    jax.jit(lambda x: x + 3.0)(number)
    assert asked == [(None, False), (OPTIONS, True), (None, False)]


def test_programs_compiled_in_a_hurry_are_forgotten(asked: list[Any]) -> None:
    """A module that compares bits with a process has the same program compiled again, once."""
    number, triple = jax.device_put(1.0), jax.jit(lambda x: 3.0 * x)
    with quick_compiler():
        triple(number)
    for _ in range(2):
        forget_programs()
        triple(number)
    assert asked == [(OPTIONS, True), (None, False)]
