"""The origin of a log against the machine at hand: the differences, and whether equal bits can be expected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

BITS_DEPEND_ON = frozenset({"jax", "jaxlib", "flax", "optax", "machine", "cpu", "cores", "backend", "devices"})
"""Names whose value decides the last bits of an update beside this project's code: its compiler and its hardware."""

_COMPARED = (*sorted(BITS_DEPEND_ON), "python", "numpy", "reskpn", "commit")
_UNKNOWN = "not recorded"


@dataclass(frozen=True)
class Difference:
    """A name with two values: the one in the log and the one here."""

    name: str
    recorded: str
    here: str

    def __str__(self) -> str:
        return f"{self.name}: {self.recorded} in the log, {self.here} here"


def origin(commit: str, versions: Mapping[str, str], hardware: Mapping[str, str]) -> dict[str, str]:
    """Commit, versions and hardware in one map, so that two of them can be compared name by name."""
    return {"commit": commit, **versions, **hardware}


def differences(recorded: Iterable[Mapping[str, str]], here: Mapping[str, str]) -> list[Difference]:
    """The differences between the segments of a log and this machine, each once."""
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
