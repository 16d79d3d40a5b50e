"""The soundness of the environments beside a checkpoint: they have the arrays that the others of the run have."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from common.errors import CheckpointError, CodecError
from common.wire.messages import Environment
from services.learner.training.checkpoints import list_checkpoints, read_environments

Layout = frozenset[tuple[str, str, tuple[int, ...], bool]]
"""Path, dtype and shape of every array, and whether all of it is finite."""


def unsound_environments(checkpoint: Path) -> str | None:
    """A sentence for the first slot whose environments differ from the usual of the run in their arrays; else None.

    The learner does not know what an engine keeps, but all slots keep the same, at every version. So the usual is what
    most states beside the run's checkpoints have; of two that are as frequent, the one with more finite arrays.
    """
    layouts = _layouts(checkpoint)
    others = [path for path in list_checkpoints(checkpoint.parent.parent) if path != checkpoint]
    usual = Counter([*layouts.values(), *(layout for path in others for layout in _layouts(path).values())])
    if not usual:
        return None
    expected = max(usual, key=lambda layout: (usual[layout], sum(finite for *_, finite in layout)))
    for slot, layout in layouts.items():
        if layout != expected:
            path, dtype, shape, finite = min(layout - expected or expected - layout)
            what = f"{path} is {dtype} {list(shape)}" + ("" if finite else ", not all of it finite")
            return f"the environments of slot {slot} are not as the others of the run ({what})"
    return None


def _layouts(checkpoint: Path) -> dict[int, Layout]:
    """By slot; nothing for a file that cannot be read."""
    try:
        kept = read_environments(checkpoint)
        if kept is None:
            return {}
        return {slot: _layout(Environment.decode(data)) for slot, data in sorted(kept.states.items())}
    except (CheckpointError, CodecError):
        return {}


def _layout(environment: Environment) -> Layout:
    return frozenset(
        (path, array.dtype.name, array.shape, bool(np.isfinite(array).all()))
        for path, array in environment.arrays.items()
    )
