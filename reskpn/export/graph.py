"""An ONNX graph while it is built: its nodes, its constants, and values whose broadcasting is put off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 21
"""Of 2024; onnxruntime 1.18 and later can run it."""
IR_VERSION = 10

BATCH = "batch"
"""Name of the free axis."""

Shape = tuple[Any, ...]
"""Sizes; a size that is not an int is the free axis."""

ELEMENT_TYPES = {
    np.dtype(np.float32): TensorProto.FLOAT,
    np.dtype(np.int32): TensorProto.INT32,
    np.dtype(np.int64): TensorProto.INT64,
    np.dtype(np.bool_): TensorProto.BOOL,
}


class NotTranslatable(Exception):
    """A traced function that uses what has no translation to ONNX; the message names it."""


@dataclass(frozen=True)
class Value:
    """A tensor of the graph.

    shape: the shape that it has in the traced function.
    stored: the shape that it has in the graph: of the same rank, 1 where an axis is broadcast only when necessary,
        since ONNX's elementwise operations broadcast by themselves.
    """

    name: str
    shape: Shape
    stored: Shape
    dtype: np.dtype[Any]


Operand = Value | np.ndarray
"""A tensor, or a constant: what is made of constants alone is computed while the graph is built."""


@dataclass
class Graph:
    """Nodes and constants in the order in which they were added.

    input_with_batch: name and axis of an input that has the free axis, from which its size is read.
    """

    input_with_batch: tuple[str, int] | None = None
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    constants: dict[str, np.ndarray] = field(default_factory=dict)
    _batch_size: str | None = None

    def constant(self, array: np.ndarray) -> str:
        """The name of a constant; equal constants share one."""
        array = np.ascontiguousarray(array) if array.ndim else array
        for name, known in self.constants.items():
            if known.dtype == array.dtype and known.shape == array.shape and known.tobytes() == array.tobytes():
                return name
        name = f"c{len(self.constants)}"
        self.constants[name] = array
        return name

    def add(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """The name of the output of a new node."""
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def name(self, operand: Operand) -> str:
        """The name of an operand as it is stored."""
        return operand.name if isinstance(operand, Value) else self.constant(operand)

    def full(self, operand: Operand) -> str:
        """The name of an operand in its whole shape."""
        if isinstance(operand, Value) and operand.stored != operand.shape:
            return self.add("Expand", operand.name, self._shape_tensor(operand.shape))
        return self.name(operand)

    def reshape(self, name: str, shape: Shape) -> str:
        """A tensor in another shape."""
        sizes = [size if isinstance(size, int) else -1 for size in shape]
        if sizes.count(-1) > 1:
            raise NotTranslatable("a shape with two free axes")
        return self.add("Reshape", name, self.constant(np.array(sizes, np.int64)))

    def _shape_tensor(self, shape: Shape) -> str:
        """A shape as a tensor, the size of the free axis read from the input."""
        if all(isinstance(size, int) for size in shape):
            return self.constant(np.array(shape, np.int64))
        if self._batch_size is None:
            assert self.input_with_batch is not None, "a free axis that no input has"
            name, axis = self.input_with_batch
            self._batch_size = self.add("Shape", name, start=axis, end=axis + 1)
        parts = [
            self.constant(np.array([size], np.int64)) if isinstance(size, int) else self._batch_size for size in shape
        ]
        return self.add("Concat", *parts, axis=0)

    def initialisers(self) -> list[onnx.TensorProto]:
        """The constants as ONNX has them."""
        return [numpy_helper.from_array(array, name) for name, array in self.constants.items()]


def broadcast(shapes: Sequence[Shape]) -> Shape:
    """The shape of an elementwise operation on operands of these shapes, all of one rank or without axes."""
    rank = max(map(len, shapes))
    padded = [(1,) * (rank - len(shape)) + tuple(shape) for shape in shapes]
    return tuple(next((size for size in sizes if size != 1), 1) for sizes in zip(*padded, strict=True))
