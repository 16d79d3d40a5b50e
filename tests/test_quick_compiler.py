"""What is compiled in a hurry, and what is not."""

from __future__ import annotations

from typing import Any

import jax
import pytest
from jax._src import compiler
from quick_compiler import OPTIONS, quick_compiler


def test_programs_inside_alone_are_compiled_in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the options for that, and without most optimisations; before and after with JAX's own settings."""
    asked: list[tuple[dict[str, Any] | None, bool]] = []
    options_of = compiler.get_compile_options

    def watched(*args: Any, env_options_overrides: dict[str, Any] | None = None, **kwargs: Any) -> Any:
        asked.append((env_options_overrides or None, jax.config.read("jax_disable_most_optimizations")))
        return options_of(*args, env_options_overrides=env_options_overrides, **kwargs)

    monkeypatch.setattr(compiler, "get_compile_options", watched)
    number = jax.device_put(1.0)
    jax.jit(lambda x: x + 1.0)(number)
    with quick_compiler():
        jax.jit(lambda x: x + 2.0)(number)
    jax.jit(lambda x: x + 3.0)(number)
    assert asked == [(None, False), (OPTIONS, True), (None, False)]
