"""Bytes to plain values and arrays, and back: msgpack under hard limits.

An array travels as `{"dtype", "shape", "bytes"}`: little-endian, C order, dtype out of `DTYPES`. Whatever the bytes
are, `decode` returns or raises `CodecError`, and what it allocates is bounded by the message's size and by `Limits`,
never by a length that the message declares. Nothing is ever unpickled.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from common.errors import CodecError
from common.printable import quoted

SCHEMA_VERSION = 4
"""Of all messages together: both sides of a connection must have the same."""

DTYPES: Mapping[str, np.dtype[Any]] = {
    name: np.dtype(name).newbyteorder("<")
    for name in ("float32", "float64", "int32", "int64", "uint8", "uint32", "bool")
}
MAX_NDIM = 6

_ARRAY_KEYS = {"dtype", "shape", "bytes"}
_MIB = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Upper bounds on the content of one message; msgpack's extension types are not allowed at all.

    `max_message`, `max_bin` and `max_str` are bytes, `max_array` and `max_map` the elements of one list or map, and
    `max_items` the elements of all lists and maps of a message together: a small element costs Python fifty times
    its bytes.
    """

    max_message: int = 256 * _MIB
    max_bin: int = 256 * _MIB
    max_array: int = 64
    max_map: int = 512
    max_str: int = _MIB
    max_items: int = 16_384


LIMITS = Limits()


def encode(obj: Mapping[str, Any]) -> bytes:
    """Pack a map of plain values, lists, maps with str keys, and NumPy arrays and scalars.

    Raises `CodecError`: `bad_dtype` for an array of another dtype, `bad_type` for what msgpack has no form for.
    """
    try:
        packed: bytes = _local.packer.pack(obj)
    except (TypeError, ValueError, OverflowError) as error:
        raise CodecError("bad_type", f"a message cannot hold this: {error}") from error
    return packed


def decode(data: bytes, limits: Limits = LIMITS) -> dict[str, Any]:
    """Unpack a message; its arrays are read-only views that own no memory but the message's binary parts.

    Raises `CodecError`: `too_large`, `not_msgpack`, `bad_type` (not a map), `bad_array`, `bad_dtype`.
    """
    if len(data) > limits.max_message:
        raise CodecError(
            "too_large",
            f"a message of {len(data):,} bytes; {limits.max_message:,} are allowed: "
            "run fewer environments or steps in one rollout",
        )
    counter = _Counter(limits.max_items)
    try:
        message = msgpack.unpackb(
            data,
            strict_map_key=True,
            object_hook=counter.map,
            list_hook=counter.list,
            max_bin_len=limits.max_bin,
            max_array_len=limits.max_array,
            max_map_len=limits.max_map,
            max_str_len=limits.max_str,
            max_ext_len=0,
        )
    except CodecError:
        raise
    except Exception as error:  # a dozen classes, and callbacks of the network rely on there being one
        too_large = "exceeds max_" in str(error)
        reason = "too_large" if too_large else "not_msgpack"
        raise CodecError(reason, f"{len(data):,} bytes that are not a message: {_sentence(error)}") from error
    if not isinstance(message, dict):
        raise CodecError("bad_type", f"a message is a map; given {type(message).__name__}")
    return message


class _Counter:
    """Counts the elements of one message while msgpack builds it, and turns the maps that are arrays into arrays."""

    def __init__(self, max_items: int) -> None:
        self._max = max_items
        self._items = 0

    def list(self, items: list[Any]) -> list[Any]:
        self._add(len(items))
        return items

    def map(self, items: dict[Any, Any]) -> Any:
        self._add(len(items))
        return _unpack_array(items) if items.keys() == _ARRAY_KEYS else items

    def _add(self, count: int) -> None:
        self._items += count
        if self._items > self._max:
            raise CodecError("too_large", f"a message of more than {self._max:,} elements; so many are allowed")


def _pack_array(value: object) -> Any:
    if isinstance(value, np.generic) and value.dtype.name in DTYPES:
        return value.item()
    if not isinstance(value, np.ndarray):
        raise CodecError("bad_type", f"a message cannot hold a {type(value).__name__}; give plain values or arrays")
    name = value.dtype.name
    if name not in DTYPES:
        raise CodecError("bad_dtype", f"an array of dtype {name}; allowed: {', '.join(DTYPES)}")
    array = np.asarray(value, dtype=DTYPES[name], order="C")
    return {"dtype": name, "shape": array.shape, "bytes": array.data}


class _Local(threading.local):
    """One packer a thread: reused it keeps its buffer, which makes it several times faster than `msgpack.packb`.

    A packer must not be shared: `pack` gives other threads a turn while its buffer is half full.
    """

    def __init__(self) -> None:
        self.packer = msgpack.Packer(default=_pack_array)


_local = _Local()


def _unpack_array(raw: Mapping[str, Any]) -> np.ndarray:
    name, shape, data = raw["dtype"], raw["shape"], raw["bytes"]
    if not isinstance(name, str) or name not in DTYPES:
        raise CodecError("bad_dtype", f"an array of dtype {quoted(name, 40)}; allowed: {', '.join(DTYPES)}")
    dtype = DTYPES[name]
    if not isinstance(data, bytes) or not _is_shape(shape):
        raise CodecError(
            "bad_array",
            f"an array needs bytes and a shape of at most {MAX_NDIM} sizes >= 0; given {_shape_text(shape)}",
        )
    if len(data) != math.prod(shape) * dtype.itemsize:
        raise CodecError("bad_array", f"{len(data):,} bytes for an array of shape {tuple(shape)} and dtype {name}")
    if name == "bool" and np.frombuffer(data, np.uint8).max(initial=0) > 1:
        raise CodecError("bad_array", "a bool array with a byte that is neither 0 nor 1")
    return np.frombuffer(data, dtype).reshape(shape)


def _is_shape(shape: object) -> bool:
    # The bound on a size keeps NumPy's own index arithmetic from overflowing when another size is 0.
    return (
        isinstance(shape, list)
        and len(shape) <= MAX_NDIM
        and all(type(size) is int and 0 <= size < 2**31 for size in shape)
        and math.prod(size for size in shape if size) < 2**48
    )


def _shape_text(shape: object) -> str:
    # A list holds at most `Limits.max_array` elements, any of which may be a giant itself.
    if not isinstance(shape, list):
        return quoted(shape)
    sizes = [quoted(size, 20) for size in shape[: MAX_NDIM + 1]]
    return f"[{', '.join(sizes)}{', ...' if len(shape) > len(sizes) else ''}]"


def _sentence(error: Exception) -> str:
    return f"{error}"[:200] or type(error).__name__
