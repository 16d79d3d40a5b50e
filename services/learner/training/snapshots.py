"""Published policies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from common.wire.messages import Snapshot, digest_arrays


def make_snapshot(run: str, version: int, arrays: Mapping[str, np.ndarray]) -> Snapshot:
    """The snapshot of a version, with its digest."""
    return Snapshot(run, version, digest_arrays(arrays), dict(arrays))
