"""A function written in JAX as an ONNX model: traced once, and translated operation by operation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
import onnx
from jax.extend.core import ClosedJaxpr, Literal
from jax.interpreters import partial_eval
from onnx import helper

from reskpn.export.graph import BATCH, ELEMENT_TYPES, IR_VERSION, OPSET, Graph, NotTranslatable, Operand, Shape, Value
from reskpn.export.operations import TRANSLATIONS
from reskpn.export.selections import SELECTIONS

_TABLE = TRANSLATIONS | SELECTIONS

_INLINED = {"jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint"}
"""Operations that are a traced function of their own."""


def to_onnx(
    function: Callable[..., Sequence[Any]],
    inputs: Mapping[str, jax.ShapeDtypeStruct],
    outputs: Sequence[str],
    *,
    name: str,
) -> onnx.ModelProto:
    """The model that computes `function`.

    Args:
        function: takes the inputs in their order, returns the outputs in theirs. Constants in it become part of the
            model.
        inputs: by name; one symbolic size, of one axis, stays free.

    Raises:
        NotTranslatable: the function has an operation that is in neither table.
    """
    closed = jax.make_jaxpr(lambda *given: tuple(function(*given)))(*inputs.values())
    # Most of what a task's step computes is not asked for here.
    traced, used = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
    assert all(used)
    graph = Graph(_free_axis(inputs))
    arguments: list[Operand] = [
        Value(given, tuple(spec.shape), tuple(spec.shape), np.dtype(spec.dtype)) for given, spec in inputs.items()
    ]
    results = _translate(graph, traced, list(closed.consts), arguments)
    for wanted, result in zip(outputs, results, strict=True):
        graph.nodes.append(helper.make_node("Identity", [graph.full(result)], [wanted]))
    avals: list[Any] = [variable.aval for variable in traced.outvars]
    described = [
        _described(wanted, tuple(aval.shape), np.dtype(aval.dtype)) for wanted, aval in zip(outputs, avals, strict=True)
    ]
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            name,
            [_described(given, tuple(spec.shape), np.dtype(spec.dtype)) for given, spec in inputs.items()],
            described,
            graph.initialisers(),
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="reskpn",
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def _free_axis(inputs: Mapping[str, jax.ShapeDtypeStruct]) -> tuple[str, int] | None:
    return next(
        (
            (name, axis)
            for name, spec in inputs.items()
            for axis, size in enumerate(spec.shape)
            if not isinstance(size, int)
        ),
        None,
    )


def _described(name: str, shape: Shape, dtype: np.dtype[Any]) -> onnx.ValueInfoProto:
    sizes = [size if isinstance(size, int) else BATCH for size in shape]
    return helper.make_tensor_value_info(name, ELEMENT_TYPES[dtype], sizes)


def _translate(graph: Graph, traced: Any, constants: Sequence[Any], arguments: Sequence[Operand]) -> list[Operand]:
    """The results of a traced function for operands in the graph."""
    known: dict[Any, Operand] = dict(zip(traced.constvars, map(np.asarray, constants), strict=True))
    known |= dict(zip(traced.invars, arguments, strict=True))

    def read(atom: Any) -> Operand:
        aval = atom.aval
        return np.asarray(atom.val, aval.dtype) if isinstance(atom, Literal) else known[atom]

    for equation in traced.eqns:
        operands = [read(atom) for atom in equation.invars]
        known |= dict(zip(equation.outvars, _outputs(graph, equation, operands), strict=True))
    return [read(atom) for atom in traced.outvars]


def _outputs(graph: Graph, equation: Any, operands: list[Operand]) -> list[Operand]:
    name = equation.primitive.name
    if name in _INLINED:
        inner = equation.params.get("jaxpr") or equation.params.get("call_jaxpr")
        if isinstance(inner, ClosedJaxpr):
            return _translate(graph, inner.jaxpr, inner.consts, operands)
        return _translate(graph, inner, (), operands)
    sizes = [size for variable in equation.outvars for size in variable.aval.shape]
    if not any(isinstance(operand, Value) for operand in operands) and all(isinstance(size, int) for size in sizes):
        found = equation.primitive.bind(*operands, **equation.params)
        return [np.asarray(array) for array in (found if equation.primitive.multiple_results else [found])]
    if name not in _TABLE:
        raise NotTranslatable(f"the operation {name}")
    return [_TABLE[name](graph, equation, operands)]
