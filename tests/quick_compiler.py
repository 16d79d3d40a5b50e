"""XLA in a hurry, for programs that run a few times on a few numbers: nearly all of their cost is the compiler's.

Their operations stay the same. Left out are LLVM's optimisation and most of XLA's, the fusion emitters, which take
longer than all the rest, and the splitting of a program into modules. Processes that a test starts compile as a user's.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax
from jax._src import compiler

OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 1}
FLAGS = [f"--{name}={str(value).lower()}" for name, value in OPTIONS.items()]
"""The same for a process, in its XLA_FLAGS."""


_LEFT = threading.Event()
"""Set while programs that were compiled in a hurry may lie in JAX's caches."""


def forget_programs() -> None:
    """Let JAX compile anew what it has compiled in a hurry: some of it has other bits."""
    if _LEFT.is_set():
        jax.clear_caches()
        _LEFT.clear()


@contextmanager
def quick_compiler() -> Iterator[None]:
    """Whatever this process compiles inside is compiled in a hurry; options that a program asks for go before these."""
    before = jax.config.read("jax_disable_most_optimizations")
    options_of = compiler.get_compile_options

    def hurried(*args: Any, env_options_overrides: dict[str, Any] | None = None, **kwargs: Any) -> Any:
        return options_of(*args, env_options_overrides=OPTIONS | (env_options_overrides or {}), **kwargs)

    jax.config.update("jax_disable_most_optimizations", True)
    compiler.get_compile_options = hurried
    _LEFT.set()
    try:
        yield
    finally:
        compiler.get_compile_options = options_of
        jax.config.update("jax_disable_most_optimizations", before)
