"""The result of a check: one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from common.errors import ReskpnError
from common.printable import printable

Level = Literal["ok", "warning", "problem"]


@dataclass(frozen=True)
class Finding:
    """One result: what was found, what to do about it, and figures for machines with units in their names."""

    name: str
    level: Level
    text: str
    advice: str = ""
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def line(self) -> str:
        return f"{self.level:<8} {self.name:<10} {self.text}{f'; {self.advice}' if self.advice else ''}"


def guarded(name: str, check: Callable[[], Finding]) -> Finding:
    """The check's finding; a check that raises is a problem in itself, and the others continue."""
    try:
        return check()
    except ReskpnError as error:
        return Finding(name, "problem", printable(str(error), 500))
    except Exception as error:  # a broken library may raise anything, and finding that out is the purpose
        return Finding(name, "problem", printable(f"{type(error).__name__}: {error}", 500), "install it again")


def size(count: float) -> str:
    """1.5 GB, 22.0 MB, 512 bytes."""
    for unit, name in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= unit:
            return f"{count / unit:,.1f} {name}"
    return f"{count:,.0f} bytes"
