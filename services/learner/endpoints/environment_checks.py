"""Checks of an environment state against the run: a resumed run, whose actors go on from it, must not fail on it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from common.errors import CodecError
from common.physics.state_shapes import Shapes
from common.printable import quoted
from common.wire.fields import MAX_MAGNITUDE, require_bounded


class EnvironmentChecks:
    """The arrays that the environments of one slot consist of, and what they may hold."""

    def __init__(self, shapes: Shapes, episode_length: int) -> None:
        self._shapes = shapes
        self._episode_length = episode_length

    def check(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Raises `CodecError`: `bad_fields`, `bad_dtype`, `bad_shape`, `not_finite`, `too_big`, `bad_value`."""
        if strays := sorted(arrays.keys() ^ self._shapes.keys()):
            names = ", ".join(quoted(name, 40) for name in strays[:4])
            raise CodecError("bad_fields", f"{names} not on both sides: these are no environments of this run")
        for name, (dtype, shape) in self._shapes.items():
            given = arrays[name]
            if given.dtype.name != dtype:
                raise CodecError("bad_dtype", f"{name} has dtype {given.dtype.name}; expected {dtype}")
            if given.shape != shape:
                raise CodecError("bad_shape", f"{name} has shape {given.shape}; expected {shape}")
            if dtype == "float32":
                require_bounded(name, given, MAX_MAGNITUDE)
            elif given.size and given.min() < 0:
                raise CodecError("bad_value", f"{name} has {given.min()}; allowed: 0 or more")
        if (most := arrays["steps"].max(initial=0)) >= self._episode_length:
            raise CodecError("bad_value", f"steps has {most}; allowed: less than {self._episode_length:,}")
