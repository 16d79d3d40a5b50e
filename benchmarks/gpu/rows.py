"""Rows of results, from the process that measures to the one that reports: JSON objects, one on each marked line."""

from __future__ import annotations

import json
import sys
from typing import Any

MARK = "row: "
"""What begins a line with a row; JAX, Warp and others print lines of their own."""

Row = dict[str, Any]


def tell(**row: Any) -> None:
    """Hand a row over at once, so that it is kept if the process is stopped later."""
    print(MARK + json.dumps(row), flush=True)


def row_in(line: str) -> Row | None:
    """The row in a line of output; None where it has none."""
    if not line.startswith(MARK):
        return None
    row: Row = json.loads(line.removeprefix(MARK))
    return row


def plan_of(arguments: list[str] | None = None) -> dict[str, Any]:
    """The plan that the process was started with, its only argument."""
    (text,) = sys.argv[1:] if arguments is None else arguments
    plan: dict[str, Any] = json.loads(text)
    return plan
