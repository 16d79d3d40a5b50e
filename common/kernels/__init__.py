"""The kernels by name; a kernel is one file of this folder, found by its name when the package is imported.

Nothing here imports JAX, so settings can be checked against kernels, and logs read, without it.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from importlib import import_module
from pkgutil import iter_modules

from common.kernels.kernel import Kernel, Parameters


def kernels_in(folders: Iterable[str], package: str) -> dict[str, type[Kernel]]:
    """The kernels that are defined in the modules of the folders, by name and in its order."""
    found = [
        kind
        for module in iter_modules(folders)
        for kind in vars(import_module(f"{package}.{module.name}")).values()
        if inspect.isclass(kind) and issubclass(kind, Kernel) and not inspect.isabstract(kind)
    ]
    return {kind.name: kind for kind in sorted(found, key=lambda kind: kind.name)}


KERNELS = kernels_in(__path__, __name__)


def make_kernel(name: str, parameters: Parameters) -> Kernel:
    """The kernel of that name (a key of `KERNELS`) with a run's parameters."""
    return KERNELS[name].from_parameters(parameters)
