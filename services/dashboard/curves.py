"""Curves of bounded length: one row of numbers for each update, or for so many that a plot has enough of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

LIMIT = 2000
"""Rows at which neighbours are put together: about two for each pixel of a plot."""

PLACES = ("env_steps", "version", "hours")
"""Columns that say where a row is; of several rows the last counts."""

Row = Mapping[str, float | None]


class Curves:
    """Columns of equal length, by name; rows are in the order of their versions.

    Past the limit each row is the mean of two, then four, ... updates. `epoch` changes when rows that were given out
    before are no longer those that are here.
    """

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit = limit
        self._columns: dict[str, list[float | None]] = {name: [] for name in PLACES}
        self._pending: list[Row] = []
        self._width = 1
        self._last_version = -1
        self.epoch = 0

    def __len__(self) -> int:
        return len(self._columns["version"])

    @property
    def width(self) -> int:
        """Updates that one row stands for."""
        return self._width

    def add(self, version: int, row: Row) -> None:
        """Add the row of an update. A version that was reached before is left out: a curve never goes back."""
        if version <= self._last_version:
            return
        self._last_version = version
        self._pending.append({**row, "version": version})
        if len(self._pending) >= self._width:
            self._append(_merged(self._pending))
            self._pending = []
        if len(self) >= self._limit:
            self._halve()

    def since(self, start: int) -> dict[str, list[float | None]]:
        """The rows from that number on."""
        return {name: values[start:] for name, values in self._columns.items()}

    def _append(self, row: Row) -> None:
        length = len(self)
        for name in row.keys() - self._columns.keys():
            self._columns[name] = [None] * length
            self.epoch += 1
        for name, values in self._columns.items():
            values.append(row.get(name))

    def _halve(self) -> None:
        rows = [dict(zip(self._columns, values, strict=True)) for values in zip(*self._columns.values(), strict=True)]
        names, self._width = list(self._columns), 2 * self._width
        halved = [_merged(rows[place : place + 2]) for place in range(0, len(rows), 2)]
        self._columns = {name: [row.get(name) for row in halved] for name in names}
        self.epoch += 1


def _merged(rows: Sequence[Row]) -> dict[str, float | None]:
    """One row for several: the last place, and the mean of what is known of each curve."""
    if len(rows) == 1:
        return dict(rows[0])
    merged: dict[str, float | None] = {}
    for name in {name: None for row in rows for name in row}:
        known = [value for row in rows if (value := row.get(name)) is not None]
        mean = float(f"{sum(known) / len(known):.6g}") if known else None
        merged[name] = rows[-1].get(name) if name in PLACES else mean
    return merged
