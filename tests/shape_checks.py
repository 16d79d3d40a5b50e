"""The run-time type checker that `conftest.py` puts on `common.maths`."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
from beartype import beartype


def check(function: Callable) -> Callable:
    """beartype, except for dataclasses that JAX builds around something else than arrays.

    JAX also puts its own placeholders (shapes, argument descriptions) into a registered dataclass, and
    `trees.from_arrays` puts NumPy arrays there; neither is what the annotations speak of.
    """
    checked = beartype(function)
    if function.__name__ != "__init__":
        return checked

    @functools.wraps(function)
    def check_if_arrays(*args: Any, **kwargs: Any) -> Any:
        leaves = jax.tree.leaves((args[1:], kwargs))
        of_arrays = all(isinstance(leaf, jax.Array) for leaf in leaves)
        return (checked if of_arrays else function)(*args, **kwargs)

    return check_if_arrays
