"""JAX's operations as ONNX nodes: those that policies, and observations and rewards of tasks, are made of.

Each translation takes the graph, the equation and its operands, at least one of which is not a constant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from reskpn.export.graph import ELEMENT_TYPES, Graph, NotTranslatable, Operand, Shape, Value, broadcast

Translation = Callable[[Graph, Any, list[Operand]], Value]

TRANSLATIONS: dict[str, Translation] = {}
"""By the name of the operation."""


def translates(table: dict[str, Translation], *names: str) -> Callable[[Translation], Translation]:
    """Enter a translation into a table, under the operations' names."""

    def register(translation: Translation) -> Translation:
        table.update(dict.fromkeys(names, translation))
        return translation

    return register


def stored_shape(operand: Operand) -> Shape:
    return operand.stored if isinstance(operand, Value) else operand.shape


def result_of(equation: Any, name: str, stored: Shape | None = None) -> Value:
    """The output of an equation; `stored` where it is not in its whole shape."""
    aval = equation.outvars[0].aval
    dtype = np.dtype(aval.dtype)
    if dtype not in ELEMENT_TYPES:
        raise NotTranslatable(f"numbers of type {dtype}")
    shape = tuple(aval.shape)
    return Value(name, shape, shape if stored is None else stored, dtype)


def _elementwise(kind: str, **attributes: Any) -> Translation:
    """An operation that ONNX has, too, and broadcasts."""

    def translate(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
        name = graph.add(kind, *map(graph.name, operands), **attributes)
        return result_of(equation, name, broadcast([stored_shape(operand) for operand in operands]))

    return translate


def _chain(*kinds: str) -> Translation:
    """Operations of one operand, one after the other."""

    def translate(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
        name = graph.name(operands[0])
        for kind in kinds:
            name = graph.add(kind, name)
        return result_of(equation, name, stored_shape(operands[0]))

    return translate


TRANSLATIONS |= {
    "add": _elementwise("Add"),
    "add_any": _elementwise("Add"),
    "sub": _elementwise("Sub"),
    "mul": _elementwise("Mul"),
    "div": _elementwise("Div"),
    "max": _elementwise("Max"),
    "min": _elementwise("Min"),
    "pow": _elementwise("Pow"),
    "rem": _elementwise("Mod", fmod=1),
    "eq": _elementwise("Equal"),
    "lt": _elementwise("Less"),
    "le": _elementwise("LessOrEqual"),
    "gt": _elementwise("Greater"),
    "ge": _elementwise("GreaterOrEqual"),
    "round": _chain("Round"),
    "is_finite": _chain(),
    **{
        name: _chain(kind)
        for name, kind in {
            "neg": "Neg", "abs": "Abs", "sign": "Sign", "floor": "Floor", "ceil": "Ceil", "exp": "Exp", "log": "Log",
            "sqrt": "Sqrt", "tanh": "Tanh", "logistic": "Sigmoid", "erf": "Erf", "sin": "Sin", "cos": "Cos",
            "tan": "Tan", "asin": "Asin", "acos": "Acos", "atan": "Atan", "sinh": "Sinh", "cosh": "Cosh",
        }.items()
    },
    "rsqrt": _chain("Sqrt", "Reciprocal"),
    "copy": _chain("Identity"),
    "stop_gradient": _chain("Identity"),
}  # fmt: skip


@translates(TRANSLATIONS, "is_finite")
def _is_finite(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    name = graph.name(operands[0])
    lost = graph.add("Or", graph.add("IsInf", name), graph.add("IsNaN", name))
    return result_of(equation, graph.add("Not", lost), stored_shape(operands[0]))


@translates(TRANSLATIONS, "ne")
def _not_equal(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    name = graph.add("Not", graph.add("Equal", *map(graph.name, operands)))
    return result_of(equation, name, broadcast([stored_shape(operand) for operand in operands]))


@translates(TRANSLATIONS, "and", "or", "xor", "not")
def _logical(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    """Of truth values, or of the bits of integers, which ONNX keeps apart."""
    kind = equation.primitive.name.capitalize()
    of_bits = np.dtype(equation.invars[0].aval.dtype) != np.bool_
    name = graph.add(f"Bitwise{kind}" if of_bits else kind, *map(graph.name, operands))
    return result_of(equation, name, broadcast([stored_shape(operand) for operand in operands]))


@translates(TRANSLATIONS, "square")
def _square(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    name = graph.name(operands[0])
    return result_of(equation, graph.add("Mul", name, name), stored_shape(operands[0]))


@translates(TRANSLATIONS, "integer_pow")
def _integer_pow(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    exponent = graph.constant(np.array(equation.params["y"], np.float32))
    return result_of(equation, graph.add("Pow", graph.name(operands[0]), exponent), stored_shape(operands[0]))


@translates(TRANSLATIONS, "log1p")
def _log1p(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    shifted = graph.add("Add", graph.name(operands[0]), graph.constant(np.array(1.0, np.float32)))
    return result_of(equation, graph.add("Log", shifted), stored_shape(operands[0]))


@translates(TRANSLATIONS, "convert_element_type")
def _cast(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    wanted = np.dtype(equation.params["new_dtype"])
    if wanted not in ELEMENT_TYPES:
        raise NotTranslatable(f"numbers of type {wanted}")
    return result_of(
        equation, graph.add("Cast", graph.name(operands[0]), to=ELEMENT_TYPES[wanted]), stored_shape(operands[0])
    )


@translates(TRANSLATIONS, "select_n")
def _select(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    which, *cases = operands
    if len(cases) != 2 or np.dtype(equation.invars[0].aval.dtype) != np.bool_:
        raise NotTranslatable("a choice between more than two cases")
    name = graph.add("Where", graph.name(which), graph.name(cases[1]), graph.name(cases[0]))
    return result_of(equation, name, broadcast([stored_shape(operand) for operand in operands]))


@translates(TRANSLATIONS, "clamp")
def _clamp(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    low, value, high = map(graph.name, operands)
    name = graph.add("Min", graph.add("Max", value, low), high)
    return result_of(equation, name, broadcast([stored_shape(operand) for operand in operands]))


@translates(TRANSLATIONS, "broadcast_in_dim")
def _broadcast_in_dim(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    """Axes of size 1 are inserted; that they are longer matters only to operations that do not broadcast."""
    places = equation.params["broadcast_dimensions"]
    stored: list[Any] = [1] * len(equation.params["shape"])
    for place, size in zip(places, stored_shape(operands[0]), strict=True):
        stored[place] = size
    name = graph.name(operands[0])
    if tuple(stored) != stored_shape(operands[0]):
        name = graph.reshape(name, tuple(stored))
    return result_of(equation, name, tuple(stored))


@translates(TRANSLATIONS, "reshape", "squeeze", "expand_dims")
def _reshape(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    return result_of(equation, graph.reshape(graph.full(operands[0]), tuple(equation.outvars[0].aval.shape)))


@translates(TRANSLATIONS, "transpose")
def _transpose(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    order = equation.params["permutation"]
    stored = tuple(stored_shape(operands[0])[axis] for axis in order)
    return result_of(equation, graph.add("Transpose", graph.name(operands[0]), perm=order), stored)


@translates(TRANSLATIONS, "tile")
def _tile(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    repeats = graph.constant(np.array(equation.params["reps"], np.int64))
    return result_of(equation, graph.add("Tile", graph.full(operands[0]), repeats))


@translates(TRANSLATIONS, "concatenate")
def _concatenate(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    name = graph.add("Concat", *map(graph.full, operands), axis=equation.params["dimension"])
    return result_of(equation, name)


@translates(TRANSLATIONS, "stack")
def _stack(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    axis = equation.params["axis"]
    where = graph.constant(np.array([axis], np.int64))
    layers = [graph.add("Unsqueeze", graph.full(operand), where) for operand in operands]
    return result_of(equation, graph.add("Concat", *layers, axis=axis))


@translates(TRANSLATIONS, "reduce_sum", "reduce_max", "reduce_min", "reduce_prod", "reduce_and", "reduce_or")
def _reduce(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    kind = equation.primitive.name.removeprefix("reduce_")
    axes = graph.constant(np.array(equation.params["axes"], np.int64))
    name = graph.full(operands[0])
    if kind in ("and", "or"):  # of truth values: the least, or the greatest, of 0 and 1
        number = graph.add("Cast", name, to=ELEMENT_TYPES[np.dtype(np.int32)])
        least = graph.add("ReduceMin" if kind == "and" else "ReduceMax", number, axes, keepdims=0)
        return result_of(equation, graph.add("Cast", least, to=ELEMENT_TYPES[np.dtype(np.bool_)]))
    return result_of(equation, graph.add(f"Reduce{kind.capitalize()}", name, axes, keepdims=0))


@translates(TRANSLATIONS, "dot_general")
def _dot_general(graph: Graph, equation: Any, operands: list[Operand]) -> Value:
    """A product over any axes: each side becomes [batch axes, rows, inner] or [batch axes, inner, columns]."""
    contracted, batched = equation.params["dimension_numbers"]
    shapes = [tuple(variable.aval.shape) for variable in equation.invars]
    names = list(map(graph.full, operands))
    if [len(shape) for shape in shapes] == [2, 2] and not batched[0] and len(contracted[0]) == 1:
        left = names[0] if contracted[0][0] == 1 else graph.add("Transpose", names[0], perm=[1, 0])
        right = names[1] if contracted[1][0] == 0 else graph.add("Transpose", names[1], perm=[1, 0])
        return result_of(equation, graph.add("MatMul", left, right))
    sides = []
    for side in (0, 1):
        together, inner = list(batched[side]), list(contracted[side])
        free = [axis for axis in range(len(shapes[side])) if axis not in (*together, *inner)]
        order = [*together, *free, *inner] if side == 0 else [*together, *inner, *free]
        moved = names[side]
        if order != sorted(order):
            moved = graph.add("Transpose", moved, perm=order)
        sizes = [tuple(shapes[side][axis] for axis in axes) for axes in (together, free, inner)]
        middle = (_count(sizes[1]), _count(sizes[2]))
        sides.append(graph.reshape(moved, (*sizes[0], *(middle if side == 0 else middle[::-1]))))
    product = graph.add("MatMul", *sides)
    return result_of(equation, graph.reshape(product, tuple(equation.outvars[0].aval.shape)))


def _count(sizes: Sequence[Any]) -> Any:
    """The number of elements; a free axis stands for itself."""
    if all(isinstance(size, int) for size in sizes):
        return int(np.prod(sizes, dtype=np.int64))
    if len(sizes) > 1:
        raise NotTranslatable("a product over a free axis beside others")
    return sizes[0]
