"""Where a log was made against where it is replayed: what differs, and whether equal bits can be expected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

BITS_DEPEND_ON = frozenset({"jax", "jaxlib", "flax", "optax", "machine", "cpu", "cores", "backend", "devices"})
"""What the last bits of an update depend on besides this project's code: what compiles it and what it runs on."""

_COMPARED = (*sorted(BITS_DEPEND_ON), "python", "numpy", "reskpn", "commit")
_UNKNOWN = "not recorded"


@dataclass(frozen=True)
class Difference:
    """One thing that was not the same: its value in the log, and here."""

    name: str
    recorded: str
    here: str

    def __str__(self) -> str:
        return f"{self.name}: {self.recorded} in the log, {self.here} here"


def differences(recorded: Iterable[Mapping[str, str]], here: Mapping[str, str]) -> list[Difference]:
    """What differs between any segment of a log and this machine, each once."""
    found = [
        Difference(name, there.get(name, _UNKNOWN), here.get(name, _UNKNOWN))
        for there in recorded
        for name in _COMPARED
        if there.get(name) != here.get(name)
    ]
    return list(dict.fromkeys(found))


def bits_can_differ(found: Iterable[Difference]) -> bool:
    """Whether one of the differences explains other bits for the same update of the same code."""
    return any(difference.name in BITS_DEPEND_ON for difference in found)
