"""Selections of elements as ONNX nodes: slices, gathers and scatters whose places are known beforehand."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from reskpn.export.graph import Graph, NotTranslatable, Operand, Value
from reskpn.export.operations import Translation, result_of, translates

SELECTIONS: dict[str, Translation] = {}
"""By the name of the operation."""


@translates(SELECTIONS, "slice")
def _slice(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    shape, starts = equation.invars[0].aval.shape, equation.params["start_indices"]
    limits, strides = equation.params["limit_indices"], equation.params["strides"] or (1,) * len(starts)
    parts = [
        (axis, start, limit, stride)
        for axis, (start, limit, stride) in enumerate(zip(starts, limits, strides, strict=True))
        if (start, stride) != (0, 1) or limit != shape[axis]
    ]
    if not parts:
        return result_of(equation, graph.full(operands[0]))
    if not all(isinstance(size, int) for part in parts for size in part):
        raise NotTranslatable("a part of a free axis")
    axes, *bounds = (graph.constant(np.array(column, np.int64)) for column in zip(*parts, strict=True))
    return result_of(equation, graph.add("Slice", graph.full(operands[0]), bounds[0], bounds[1], axes, bounds[2]))


@translates(SELECTIONS, "gather", "dynamic_slice", "rev")
def _gather(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    """A selection of elements. Where it is not along one axis, the operation itself, applied to the numbers of the
    elements, says which it takes."""
    whole, *where = operands
    if any(isinstance(operand, Value) for operand in where):
        raise NotTranslatable("an index that depends on an observation")
    axis = _axis_of_gather(equation)
    if axis is not None:
        rows = np.asarray(where[0])[..., 0]
        return result_of(
            equation, graph.add("Gather", graph.full(whole), graph.constant(rows.astype(np.int64)), axis=axis)
        )
    shape = equation.invars[0].aval.shape
    if not all(isinstance(size, int) for size in shape):
        raise NotTranslatable("a selection from a free axis")
    numbers = np.arange(int(np.prod(shape, dtype=np.int64)), dtype=np.int32).reshape(shape)
    taken = np.asarray(equation.primitive.bind(numbers, *where, **equation.params))
    flat = graph.reshape(graph.full(whole), (-1,))
    return result_of(equation, graph.add("Gather", flat, graph.constant(taken.astype(np.int64)), axis=0))


def _axis_of_gather(equation: Any) -> int | None:
    """The axis along which whole slices are taken, by one list of indices whose axis replaces it; None otherwise."""
    if equation.primitive.name != "gather":
        return None
    numbers, sizes = equation.params["dimension_numbers"], equation.params["slice_sizes"]
    shape, rank = equation.invars[0].aval.shape, len(equation.outvars[0].aval.shape)
    if len(numbers.collapsed_slice_dims) != 1 or numbers.start_index_map != numbers.collapsed_slice_dims:
        return None
    (axis,) = numbers.collapsed_slice_dims
    whole = all(size == full for at, (size, full) in enumerate(zip(sizes, shape, strict=True)) if at != axis)
    in_place = numbers.offset_dims == tuple(at for at in range(rank) if at != axis) and rank == len(shape)
    return axis if whole and in_place and not numbers.operand_batching_dims else None


@translates(SELECTIONS, "scatter", "scatter-add")
def _scatter(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    """Elements replaced, or added to, at places that are known: a selection from the old and the new ones."""
    whole, where, new = operands
    if isinstance(where, Value):
        raise NotTranslatable("an index that depends on an observation")
    shape, new_shape = (equation.invars[place].aval.shape for place in (0, 2))
    count, new_count = (int(np.prod(sizes, dtype=np.int64)) for sizes in (shape, new_shape))
    given = equation.params
    options = {name: given[name] for name in ("indices_are_sorted", "unique_indices", "mode")}
    if equation.primitive.name == "scatter-add":
        nothing_hit, one_each = jnp.zeros(shape, jnp.int32), jnp.ones(new_shape, jnp.int32)
        hits = lax.scatter_add(nothing_hit, jnp.asarray(where), one_each, given["dimension_numbers"], **options)
        if np.max(np.asarray(hits), initial=0) > 1:
            raise NotTranslatable("several numbers added at one place")
    old_numbers = jnp.arange(count, dtype=jnp.int32).reshape(shape)
    new_numbers = jnp.arange(count, count + new_count, dtype=jnp.int32).reshape(new_shape)
    numbers = lax.scatter(old_numbers, jnp.asarray(where), new_numbers, given["dimension_numbers"], **options)
    taken = np.asarray(numbers).astype(np.int64)
    old, added = (graph.reshape(graph.full(operand), (-1,)) for operand in (whole, new))
    if equation.primitive.name == "scatter":
        both = graph.add("Concat", old, added, axis=0)
        return result_of(equation, graph.add("Gather", both, graph.constant(taken), axis=0))
    nothing = graph.constant(np.zeros(count, equation.outvars[0].aval.dtype))
    both = graph.add("Concat", nothing, added, axis=0)
    change = graph.add("Gather", both, graph.constant(taken), axis=0)
    return result_of(equation, graph.add("Add", graph.full(whole), change))
