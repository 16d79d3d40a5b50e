"""State as named arrays: `{"parameters/policy/log_std": array, ...}`, the form that travels and is kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import jax
import numpy as np

from common.errors import CodecError

Tree = TypeVar("Tree")


_STORED_AS = {"representation_state": "momentum"}
"""Stored names of fields that have another name in the code: digests and logs hold the stored ones."""


def _path(keys: tuple[Any, ...]) -> str:
    field, *below = jax.tree_util.keystr(keys, simple=True, separator="/").split("/")
    return "/".join([_STORED_AS.get(field, field), *below])


def to_arrays(tree: Any) -> dict[str, np.ndarray]:
    """Every leaf by its path, fetched from the device."""
    leaves = jax.tree_util.tree_leaves_with_path(jax.device_get(tree))
    return {_path(keys): np.asarray(leaf) for keys, leaf in leaves}


def from_arrays(template: Tree, arrays: Mapping[str, np.ndarray | jax.Array]) -> Tree:
    """The tree of `template`'s structure with the arrays as leaves.

    Raises:
        CodecError: an array is missing, of another shape or type, or belongs to nothing.
    """
    leaves, structure = jax.tree_util.tree_flatten_with_path(template)
    expected = {_path(keys): leaf for keys, leaf in leaves}
    if strays := sorted(set(arrays) ^ set(expected)):
        raise CodecError(
            "bad_fields",
            f"arrays do not match the settings of this run: {', '.join(strays[:4])} "
            f"{'is' if len(strays) == 1 else 'are'} on one side only; were settings changed?",
        )
    for name, leaf in expected.items():
        given = arrays[name]
        if given.shape != leaf.shape or given.dtype != leaf.dtype:
            raise CodecError(
                "bad_shape",
                f"{name} is {given.dtype}{list(given.shape)} where the settings of this run make it "
                f"{leaf.dtype}{list(leaf.shape)}",
            )
    return jax.tree_util.tree_unflatten(structure, [arrays[name] for name in expected])
