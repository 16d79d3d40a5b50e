"""Valid messages made wrong in every way a broken or hostile peer could, from one seed."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable, Mapping
from typing import Any

import msgpack

Values = dict[str, Any]

HUGE = [2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63, 2**64 - 1, -1, -(2**63)]
INFINITE = [float("nan"), float("inf"), -float("inf")]
ODD = [*HUGE, *INFINITE, 0, 1.5, -0.0, 1e308, True, None, "", "\0", "\x1b[2J", b"", b"x"]
NAMES = ["", "*", "**", "../..", "a/b", "$*", "é" * 40, "x" * 5000, "\x1b]0;t\x07", "run-1", "a", "None", "0"]
AS_JSON = ("report",)
HEADERS = [b"\xc6", b"\xdb", b"\xdd", b"\xdf", b"\xc9"]  # bin, str, array, map and ext with a length of 32 bits


class Mutator:
    """Makes `(what was done, bytes)` out of a valid message; `messages` has an example of every kind by name."""

    def __init__(self, seed: int, messages: Mapping[str, bytes]) -> None:
        self._rng = random.Random(seed)
        self.messages = dict(messages)
        self._ways: list[tuple[str, Callable[[str], bytes]]] = [
            ("bits", self._bits),
            ("cut", self._cut),
            ("splice", self._splice),
            ("insert", self._insert),
            ("remove", self._remove),
            ("garbage", self._garbage),
            ("giant", self._giant),
            ("deep", self._deep),
            ("other kind", self._other_kind),
            ("type", self._type),
            ("missing", self._missing),
            ("extra", self._extra),
            ("number", self._number),
            ("name", self._name),
            ("not finite", self._not_finite),
            ("shape", self._shape),
            ("array", self._array),
            ("twice", self._twice),
        ]

    def make(self, kind: str) -> tuple[str, bytes]:
        name, way = self._rng.choice(self._ways)
        return name, way(kind)

    # -- bytes ---------------------------------------------------------------------------------------------

    def _bits(self, kind: str) -> bytes:
        data = bytearray(self.messages[kind])
        for _ in range(self._rng.randint(1, 8)):
            data[self._rng.randrange(len(data))] ^= 1 << self._rng.randrange(8)
        return bytes(data)

    def _cut(self, kind: str) -> bytes:
        data = self.messages[kind]
        return data[: self._rng.randrange(len(data))]

    def _splice(self, kind: str) -> bytes:
        other = self.messages[self._rng.choice(sorted(self.messages))]
        data = self.messages[kind]
        return data[: self._rng.randrange(len(data))] + other[self._rng.randrange(len(other)) :]

    def _insert(self, kind: str) -> bytes:
        data = self.messages[kind]
        place = self._rng.randrange(len(data) + 1)
        return data[:place] + self._rng.randbytes(self._rng.choice([1, 4, 4096])) + data[place:]

    def _remove(self, kind: str) -> bytes:
        data = self.messages[kind]
        place = self._rng.randrange(len(data))
        return data[:place] + data[place + self._rng.randint(1, 64) :]

    def _garbage(self, kind: str) -> bytes:
        return self._rng.randbytes(self._rng.choice([0, 1, 2, 64, 4096]))

    def _giant(self, kind: str) -> bytes:
        """A length that is declared and not there, or elements that cost more than their bytes."""
        data = self.messages[kind]
        place = self._rng.randrange(1, len(data))
        length = struct.pack(">I", self._rng.choice([2**32 - 1, 2**31, 2**28, 70_000]))
        header = self._rng.choice(HEADERS) + length
        tail = self._rng.choice([data[place:], b"\x90" * 70_000, b"\xc0" * 70_000])
        return data[:place] + header + tail

    def _deep(self, kind: str) -> bytes:
        """Lists or maps in each other, up to a quarter of a million."""
        depth = self._rng.choice([100, 1023, 1025, 20_000, 250_000])
        shell = self._rng.choice([b"\x91", b"\x81\xa1a"])
        data = self.messages[kind]
        return self._rng.choice([b"", data[: self._rng.randrange(len(data))]]) + shell * depth + b"\xc0"

    def _other_kind(self, kind: str) -> bytes:
        return self.messages[self._rng.choice(sorted(self.messages))]

    # -- fields --------------------------------------------------------------------------------------------

    def _values(self, kind: str) -> Values:
        data = self.messages[kind]
        values: Values = json.loads(data) if kind in AS_JSON else msgpack.unpackb(data)
        return values

    def _type(self, kind: str) -> bytes:
        values = self._values(kind)
        nested: list[Any] = [[], [[]], {}, {"a": {"b": []}}, [0] * 60, {"dtype": "float32", "shape": [], "bytes": b""}]
        values[self._rng.choice(sorted(values))] = self._rng.choice([*ODD, *nested])
        return _pack(kind, values)

    def _missing(self, kind: str) -> bytes:
        values = self._values(kind)
        del values[self._rng.choice(sorted(values))]
        return _pack(kind, values)

    def _extra(self, kind: str) -> bytes:
        extra = {str(self._rng.choice([*NAMES, "__class__", "schema "])) + "_": self._rng.choice(ODD)}
        return _pack(kind, self._values(kind) | extra)

    def _number(self, kind: str) -> bytes:
        return self._replaced(kind, int, self._rng.choice([*HUGE, 0, 1, 2, 3]))

    def _name(self, kind: str) -> bytes:
        return self._replaced(kind, str, self._rng.choice(NAMES))

    def _replaced(self, kind: str, which: type, by: Any) -> bytes:
        values = self._values(kind)
        names = [name for name, value in values.items() if type(value) is which] or sorted(values)
        values[self._rng.choice(sorted(names))] = by
        return _pack(kind, values)

    def _not_finite(self, kind: str) -> bytes:
        """One element of an array, or one plain number."""
        values = self._values(kind)
        bad = self._rng.choice(INFINITE)
        arrays = [array for array in _arrays(values) if array["dtype"] == "float32" and array["bytes"]]
        if not arrays:
            return self._replaced(kind, float, bad)
        array = self._rng.choice(arrays)
        place = 4 * self._rng.randrange(len(array["bytes"]) // 4)
        array["bytes"] = array["bytes"][:place] + struct.pack("<f", bad) + array["bytes"][place + 4 :]
        return _pack(kind, values)

    def _shape(self, kind: str) -> bytes:
        """An array with another shape, with and without the bytes for it."""
        values = self._values(kind)
        arrays = _arrays(values)
        if not arrays:
            return self._type(kind)
        array = self._rng.choice(arrays)
        shape = list(array["shape"])
        count = len(array["bytes"])
        array["shape"] = self._rng.choice(
            [shape[::-1], [*shape, 1], shape[1:], [count], [2**31 - 1, 0], [-1], [2**40], [0] * 7, [2**20] * 6, [1.0]]
        )
        if self._rng.random() < 0.5:
            array["bytes"] = array["bytes"] * 2
        return _pack(kind, values)

    def _array(self, kind: str) -> bytes:
        """An array of another dtype, or that is none."""
        values = self._values(kind)
        arrays = _arrays(values)
        if not arrays:
            return self._type(kind)
        array = self._rng.choice(arrays)
        what = self._rng.choice(["dtype", "bytes", "shape"])
        array[what] = self._rng.choice(["object", "float64", "int32", "uint8", "bool", "O", "<f4", b"\2" * 8, None, []])
        return _pack(kind, values)

    def _twice(self, kind: str) -> bytes:
        return self.messages[kind] * 2


def _arrays(values: Any) -> list[Values]:
    """Every map that stands for an array, however deep."""
    if not isinstance(values, dict):
        return []
    if values.keys() == {"dtype", "shape", "bytes"}:
        return [values]
    return [array for value in values.values() for array in _arrays(value)]


def _pack(kind: str, values: Values) -> bytes:
    data: bytes = json.dumps(values, default=repr).encode() if kind in AS_JSON else msgpack.packb(values)
    return data
