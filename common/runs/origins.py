"""The origin of a log against the machine at hand: the differences, and whether equal bits can be expected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from common.numerical_environment import decides_bits

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

    @property
    def excuses_bits(self) -> bool:
        """True if the last bits of an update depend on it, beside this project's code."""
        return self.name in BITS_DEPEND_ON or decides_bits(self.name)

    def __str__(self) -> str:
        return f"{self.name}: {self.recorded} in the log, {self.here} here"


def origin(
    commit: str, versions: Mapping[str, str], hardware: Mapping[str, str], environment: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Commit, versions, hardware and variables in one map, so that two of them can be compared name by name."""
    return {"commit": commit, **versions, **hardware, **(environment or {})}


def differences(recorded: Iterable[Mapping[str, str]], here: Mapping[str, str]) -> list[Difference]:
    """The differences between the segments of a log and this machine, each once."""
    found = [
        Difference(name, _value(name, there), _value(name, here))
        for there in recorded
        for name in (*_COMPARED, *sorted(filter(decides_bits, there.keys() | here.keys())))
        if there.get(name) != here.get(name)
    ]
    return list(dict.fromkeys(found))


def bits_can_differ(found: Iterable[Difference]) -> bool:
    """True if one of the differences explains other bits for the same update of the same code."""
    return any(difference.excuses_bits for difference in found)


def _value(name: str, values: Mapping[str, str]) -> str:
    return values.get(name, "not set" if decides_bits(name) else _UNKNOWN)
