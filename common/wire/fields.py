"""Readers of the fields of messages: each turns a decoded value into the field's value, or raises `CodecError`.

A reader is attached to a field's type: `slot: Annotated[int, integer(0, 9)]`. Reasons: `bad_type`, `bad_value`,
`bad_dtype`, `bad_shape`, `not_finite`; every sentence starts with the field's name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from re import Pattern
from typing import Annotated, Any

import numpy as np

from common.errors import CodecError
from common.printable import quoted
from common.wire.keys import RUN_ID

Reader = Callable[[str, Any], Any]
"""(field name, decoded value) -> value of the field."""

MAX_SLOT = 2**31 - 1
MAX_AMOUNT = 1e12
"""Of seconds and rates: sums of them stay finite, and they can be shown."""

MAX_MAGNITUDE = 1e10
"""Of observations, actions and rewards: MuJoCo's own limit on coordinates. Squares and their sums fit into float32."""

MAX_RETURN = 1e15
"""Of the sum of an episode's rewards."""


def integer(low: int = 0, high: int = 2**63 - 1) -> Reader:
    """An int in [low, high]; bool is not an int here."""

    def read(name: str, value: Any) -> int:
        if type(value) is not int:
            raise _bad_type(name, value, "an integer")
        if not low <= value <= high:
            raise CodecError("bad_value", f"{name} is {value}; allowed: {low} to {high}")
        return value

    return read


def real(high: float) -> Reader:
    """A finite float in [0, high]: all of the messages' scalars are durations and rates."""

    def read(name: str, value: Any) -> float:
        if type(value) not in (int, float):
            raise _bad_type(name, value, "a number")
        if not math.isfinite(value):
            raise CodecError("not_finite", f"{name} is {value}; allowed: a finite number")
        if not 0 <= value <= high:
            raise CodecError("bad_value", f"{name} is {value}; allowed: 0 to {high:g}")
        return float(value)

    return read


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
            raise CodecError("bad_value", f"{name} is {quoted(value)}; allowed: what matches {pattern.pattern}")
        return value

    return read


def one_of(*allowed: str) -> Reader:
    def read(name: str, value: Any) -> str:
        if type(value) is not str:
            raise _bad_type(name, value, "a text")
        if value not in allowed:
            raise CodecError("bad_value", f"{name} is {quoted(value)}; allowed: {', '.join(allowed)}")
        return value

    return read


def mapping(item: Reader, key: Reader = text(128)) -> Reader:  # noqa: B008
    """A dict whose keys and values are read by `key` and `item`."""

    def read(name: str, value: Any) -> dict[Any, Any]:
        if type(value) is not dict:
            raise _bad_type(name, value, "a map")
        return {key(f"a key of {name}", k): item(f"{name}[{quoted(k)}]", v) for k, v in value.items()}

    return read


def decimal(name: str, value: Any) -> int:
    """A key that stands for a slot: msgpack's strict maps have no int keys."""
    if type(value) is not str or len(value) > 10 or not value.isascii() or not value.isdigit():
        raise CodecError("bad_value", f"{name} is {quoted(value)}; allowed: a number in decimal digits")
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


def check_episodes(returns: np.ndarray, lengths: np.ndarray, longest: int = 2**31 - 1) -> None:
    """Raises `CodecError` unless there are as many lengths as returns, and each is one that an episode can have."""
    require_shape("episode_length", lengths, returns.shape)
    require_finite("episode_return", returns)
    if lengths.min(initial=1) < 1 or lengths.max(initial=1) > longest:
        bad = lengths.min() if lengths.min() < 1 else lengths.max()
        raise CodecError("bad_value", f"episode_length has {bad}; allowed: 1 to {longest:,} steps")


def require_bounded(name: str, given: np.ndarray, largest: float) -> None:
    """Raises `CodecError`: `not_finite` as `require_finite`; `too_big` for an element beyond +-`largest`."""
    require_finite(name, given)
    if given.size and (bad := max(-given.min(), given.max())) > largest:
        raise CodecError("too_big", f"{name} has an element of magnitude {bad:.3g}; allowed: up to {largest:g}")


def _bad_type(name: str, value: Any, expected: str) -> CodecError:
    return CodecError("bad_type", f"{name} is of type {type(value).__name__}; expected {expected}")


Count = Annotated[int, integer()]
Slot = Annotated[int, integer(0, MAX_SLOT)]
Text = Annotated[str, text(4096)]
Name = Annotated[str, text(128)]
RunId = Annotated[str, text(80, RUN_ID)]
Amount = Annotated[float, real(MAX_AMOUNT)]
Texts = Annotated[dict[str, str], mapping(text(1024))]
PerSlot = Annotated[dict[int, int], mapping(integer(), key=decimal)]
