"""The representation that a run's settings ask for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from common.config.settings import RunSettings
from common.kernels import make_kernel
from common.maths.rkhs.basis import Basis
from common.maths.rkhs.clustering import Cluster
from common.maths.rkhs.exact import Exact
from common.maths.rkhs.fourier import Fourier
from common.maths.rkhs.matching_pursuit import KernelMatchingPursuit
from common.maths.rkhs.nystrom import Nystrom
from common.maths.rkhs.representation import Representation


def make_representation(settings: RunSettings, capacity: int | None = None) -> Representation[Any, Any]:
    """By name (`common.config.rkhs.REPRESENTATIONS`). A learner without h has an exact one without centres.

    Args:
        capacity: in place of the settings'.
    """
    rkhs, seed = settings.rkhs, settings.seed
    size = settings.capacity if capacity is None else capacity
    # Settings have checked that the kernel has what the representation needs; `Any` stands for that.
    kernel: Any = make_kernel(rkhs.kernel, rkhs)
    if size == 0:
        return Exact(kernel, 0)
    makers: dict[str, Callable[[], Representation[Any, Any]]] = {
        "exact": lambda: Exact(kernel, size),
        "nystrom": lambda: Nystrom(kernel, size, rkhs.landmarks_every),
        "rff": lambda: Fourier(kernel, size, seed),
        "kmp": lambda: KernelMatchingPursuit(kernel, size, rkhs.error),
        "cluster": lambda: Cluster(kernel, size, rkhs.radius),
        "basis": lambda: Basis(kernel, size, rkhs.directions, seed),
    }
    return makers[rkhs.representation]()
