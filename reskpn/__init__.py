"""Kernel-policy reinforcement learning, from Python: train, and open runs and exported policies. See docs/api.md.

Names are imported when they are first used, so that `import reskpn` is quick and needs no JAX.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reskpn.api.errors import ReskpnError
    from reskpn.api.run import Run, RunPolicy, open_run
    from reskpn.api.training import Progress, train
    from reskpn.policy_file import Policy, load

__all__ = ["Policy", "Progress", "ReskpnError", "Run", "RunPolicy", "load", "open_run", "train"]

_MODULES = {
    "load": "policy_file",
    "Policy": "policy_file",
    "ReskpnError": "api.errors",
    "Progress": "api.training",
    "train": "api.training",
    "Run": "api.run",
    "RunPolicy": "api.run",
    "open_run": "api.run",
}
"""The module that has a name, so that an exported policy is loaded without what a run needs."""


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
