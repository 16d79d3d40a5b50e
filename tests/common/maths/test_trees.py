"""State as named arrays."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common.errors import CodecError
from common.maths import trees
from common.maths.expansion import Expansion
from common.maths.policy import Policy
from common.maths.running import Moments


def template() -> Policy:
    """A policy's structure with little in it."""
    return Policy(
        parameters={"log_std": jnp.array([0.5]), "features": {"layers": {0: {"bias": jnp.array([1.0, 2.0])}}}},
        expansion=Expansion(jnp.ones((3, 2)), jnp.zeros((3, 1))),
        observations=Moments(jnp.zeros(4), jnp.ones(4), jnp.asarray(7.0)),
    )


NAMES = [
    "expansion/centres",
    "expansion/weights",
    "observations/count",
    "observations/mean",
    "observations/variance",
    "parameters/features/layers/0/bias",
    "parameters/log_std",
]


def refusal(arrays: dict[str, np.ndarray]) -> CodecError:
    """The error that `arrays` must raise."""
    with pytest.raises(CodecError) as caught:
        trees.from_arrays(template(), arrays)
    return caught.value


def test_leaves_are_named_by_their_path():
    """Every leaf has the name by which one would reach it, and is a NumPy array."""
    arrays = trees.to_arrays(template())
    assert sorted(arrays) == NAMES
    assert all(type(array) is np.ndarray for array in arrays.values())
    np.testing.assert_array_equal(arrays["parameters/features/layers/0/bias"], [1.0, 2.0])
    assert arrays["observations/count"].shape == ()


def test_round_trip():
    """What went out comes back in the same structure, whatever the order of the names."""
    arrays = trees.to_arrays(template())
    backwards = {name: arrays[name] + 1 for name in reversed(sorted(arrays))}
    again = trees.from_arrays(template(), backwards)
    assert jax.tree.structure(again) == jax.tree.structure(template())
    for name, array in trees.to_arrays(again).items():
        np.testing.assert_array_equal(array, arrays[name] + 1)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            {"expansion/weights": None},
            "expansion/weights is on one side only",
        ),
        (
            {"expansion/wieghts": np.zeros((3, 1))},
            "expansion/wieghts is on one side only",
        ),
        (
            {"a": np.zeros(1), "b": np.zeros(1), "c": np.zeros(1), "d": np.zeros(1), "e": np.zeros(1)},
            "a, b, c, d are on one side only",
        ),
    ],
)
def test_names_must_match(change, named):
    """A missing array or one too many is refused with its name; of many, the first four are named."""
    arrays = {name: array for name, array in {**trees.to_arrays(template()), **change}.items() if array is not None}
    error = refusal(arrays)
    assert error.reason == "bad_fields"
    assert str(error) == f"arrays do not match the settings of this run: {named}; were settings changed?"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (np.zeros((4, 1), np.float32), "float32[4, 1]"),
        (np.zeros((3,), np.float32), "float32[3]"),
        (np.zeros((3, 1), np.float64), "float64[3, 1]"),
        (np.zeros((3, 1), np.int32), "int32[3, 1]"),
    ],
)
def test_shape_and_dtype_must_match(given, words):
    """An array of another shape or dtype is refused with both; nothing is converted in silence."""
    error = refusal({**trees.to_arrays(template()), "expansion/weights": given})
    assert error.reason == "bad_shape"
    assert str(error) == f"expansion/weights is {words} where the settings of this run make it float32[3, 1]"


def test_nothing_is_lost_on_the_way():
    """Bits of special values survive: not-a-number, infinities, the negative zero."""
    special = np.array([np.nan, np.inf, -np.inf, -0.0], np.float32)
    policy = replace(template(), observations=Moments(jnp.asarray(special), jnp.ones(4), jnp.asarray(7.0)))
    again = trees.from_arrays(policy, trees.to_arrays(policy))
    assert np.asarray(again.observations.mean).tobytes() == special.tobytes()
