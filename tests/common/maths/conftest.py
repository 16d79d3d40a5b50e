"""Numerics of the tests of this folder: no implicit promotion of dtypes, and programs compiled in a hurry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import optax
import pytest


def _with_promotion(function: Callable) -> Callable:
    def promoting(*args: Any, **kwargs: Any) -> Any:
        with jax.numpy_dtype_promotion("standard"):
            return function(*args, **kwargs)

    return promoting


@pytest.fixture(autouse=True, scope="module")
def strict_promotion() -> Iterator[None]:
    """Mixing dtypes is an error, except in Adam's bias correction: optax raises a float to an int32 power there."""
    with pytest.MonkeyPatch.context() as patch, jax.numpy_dtype_promotion("strict"):
        patch.setattr(optax.tree, "bias_correction", _with_promotion(optax.tree.bias_correction))
        yield


@pytest.fixture(autouse=True, scope="module")
def _everything_in_a_hurry(in_a_hurry: None) -> None:
    """For all tests of this folder."""
