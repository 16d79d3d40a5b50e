"""What a field of a message may hold: readers that turn a decoded value into the field's value or raise `CodecError`.

A reader is attached to a field's type: `slot: Annotated[int, integer(0, 9)]`. Reasons: `bad_type`, `bad_value`,
`bad_dtype`, `bad_shape`, `not_finite`; every sentence starts with the field's name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from re import Pattern
from typing import Any

import numpy as np

from common.errors import CodecError

Reader = Callable[[str, Any], Any]
"""(field name, decoded value) -> value of the field."""

MAX_SLOT = 2**31 - 1


def integer(low: int = 0, high: int = 2**63 - 1) -> Reader:
    """An int in [low, high]; bool is not an int here."""

    def read(name: str, value: Any) -> int:
        if type(value) is not int:
            raise _bad_type(name, value, "an integer")
        if not low <= value <= high:
            raise CodecError("bad_value", f"{name} is {value}; allowed: {low} to {high}")
        return value

    return read


def real(name: str, value: Any) -> float:
    """A finite float >= 0; all of the messages' scalars are durations and rates."""
    if type(value) not in (int, float):
        raise _bad_type(name, value, "a number")
    if not math.isfinite(value):
        raise CodecError("not_finite", f"{name} is {value}; allowed: a finite number")
    if value < 0:
        raise CodecError("bad_value", f"{name} is {value}; allowed: 0 or more")
    return float(value)


def flag(name: str, value: Any) -> bool:
    if type(value) is not bool:
        raise _bad_type(name, value, "true or false")
    return value


def text(max_length: int, pattern: Pattern[str] | None = None) -> Reader:
    """A str of at most `max_length` characters that matches `pattern` as a whole."""

    def read(name: str, value: Any) -> str:
        if type(value) is not str:
            raise _bad_type(name, value, "a text")
        if len(value) > max_length:
            raise CodecError("bad_value", f"{name} has {len(value):,} characters; allowed: {max_length:,}")
        if pattern is not None and not pattern.fullmatch(value):
            raise CodecError("bad_value", f"{name} is {value!r}; allowed: what matches {pattern.pattern}")
        return value

    return read


def one_of(*allowed: str) -> Reader:
    def read(name: str, value: Any) -> str:
        if type(value) is not str:
            raise _bad_type(name, value, "a text")
        if value not in allowed:
            raise CodecError("bad_value", f"{name} is {value!r:.80}; allowed: {', '.join(allowed)}")
        return value

    return read


def mapping(item: Reader, key: Reader = text(128)) -> Reader:  # noqa: B008
    """A dict whose keys and values are read by `key` and `item`."""

    def read(name: str, value: Any) -> dict[Any, Any]:
        if type(value) is not dict:
            raise _bad_type(name, value, "a map")
        return {key(f"a key of {name}", k): item(f"{name}[{k!r:.80}]", v) for k, v in value.items()}

    return read


def decimal(name: str, value: Any) -> int:
    """A key that stands for a slot: msgpack's strict maps have no int keys."""
    if type(value) is not str or len(value) > 10 or not value.isascii() or not value.isdigit():
        raise CodecError("bad_value", f"{name} is {value!r:.80}; allowed: a number in decimal digits")
    return int(integer(0, MAX_SLOT)(name, int(value)))


def array(dtype: str, axes: str) -> Reader:
    """An ndarray of `dtype` with one dimension for each letter of `axes`, as in "T N O"."""
    ndim = len(axes.split())

    def read(name: str, value: Any) -> np.ndarray:
        if not isinstance(value, np.ndarray):
            raise _bad_type(name, value, "an array")
        if value.dtype.name != dtype:
            raise CodecError("bad_dtype", f"{name} has dtype {value.dtype.name}; expected {dtype}")
        if value.ndim != ndim:
            raise CodecError("bad_shape", f"{name} has shape {value.shape}; expected [{axes}]")
        return value

    return read


def any_array(name: str, value: Any) -> np.ndarray:
    if not isinstance(value, np.ndarray):
        raise _bad_type(name, value, "an array")
    return value


def require_shape(name: str, given: np.ndarray, expected: tuple[int, ...]) -> None:
    """Raises `CodecError("bad_shape")`."""
    if given.shape != expected:
        raise CodecError("bad_shape", f"{name} has shape {given.shape}; expected {expected}")


def require_finite(name: str, given: np.ndarray) -> None:
    """Raises `CodecError("not_finite")` that names the first element which is not finite."""
    # NaN and infinity both survive min and max, which need no array of flags as large as the message.
    if given.size == 0 or (math.isfinite(given.min()) and math.isfinite(given.max())):
        return
    bad = ~np.isfinite(given)
    first = tuple(int(i) for i in np.argwhere(bad)[0])
    raise CodecError(
        "not_finite",
        f"{name} has {np.count_nonzero(bad):,} of {given.size:,} elements that are not finite, the first at {first}",
    )


def _bad_type(name: str, value: Any, expected: str) -> CodecError:
    return CodecError("bad_type", f"{name} is of type {type(value).__name__}; expected {expected}")
