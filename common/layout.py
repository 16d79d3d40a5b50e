"""Tables and lines that fit the width of a terminal: the least needed columns are left out, no word is broken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.cells import cell_len, set_cell_size
from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

GAP = 2
SHORTEST = 8
"""Cells to which a text is cut where leaving out columns was not enough."""


@dataclass(frozen=True)
class Column:
    """A column: `rank` 0 is never left out, and of the others those with the highest rank go first."""

    name: str
    rank: int = 0
    left: bool = False


@dataclass(frozen=True)
class FittedTable:
    """A table that shows as many of its columns as there is room for."""

    columns: Sequence[Column]
    rows: Sequence[Sequence[str]]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for number, line in enumerate(self.lines(options.max_width)):
            yield Text(line, style="" if number else "bold", no_wrap=True, overflow="ellipsis")

    def lines(self, width: int) -> list[str]:
        """The heading and the rows, each at most `width` cells wide."""
        cells = [[column.name for column in self.columns], *self.rows]
        widths = [max(cell_len(row[index]) for row in cells) for index in range(len(self.columns))]
        kept = fitting(self.columns, widths, width)
        over = sum(widths[index] for index in kept) + GAP * (len(kept) - 1) - width
        for index in sorted(kept, key=lambda index: -widths[index]):
            if over > 0 and self.columns[index].left:
                cut = min(over, max(0, widths[index] - SHORTEST))
                widths[index], over = widths[index] - cut, over - cut
        return [self._line(row, kept, widths) for row in cells]

    def _line(self, row: Sequence[str], kept: Sequence[int], widths: Sequence[int]) -> str:
        parts = []
        for index in kept:
            text, room = row[index], widths[index]
            if cell_len(text) > room:
                text = set_cell_size(text, room - 1) + "…"
            padding = " " * (room - cell_len(text))
            parts.append(text + padding if self.columns[index].left else padding + text)
        return (" " * GAP).join(parts).rstrip()


def fitting(columns: Sequence[Column], widths: Sequence[int], width: int) -> list[int]:
    """Indices of the columns that fit side by side, in their order."""
    kept = list(range(len(columns)))
    while sum(widths[index] for index in kept) + GAP * (len(kept) - 1) > width:
        droppable = [index for index in kept if columns[index].rank]
        if not droppable:
            break
        kept.remove(max(droppable, key=lambda index: columns[index].rank))
    return kept


@dataclass(frozen=True)
class Parts:
    """Parts of a line, which is broken between parts alone."""

    parts: Sequence[str]
    separator: str = " | "

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for line in packed(self.parts, options.max_width, self.separator):
            yield Text(line)


def packed(parts: Sequence[str], width: int, separator: str = " | ") -> list[str]:
    """Lines of at most `width` cells made of as many parts as fit; a part that is wider has a line of its own."""
    lines: list[str] = []
    for part in parts:
        longer = f"{lines[-1]}{separator}{part}" if lines else part
        if lines and cell_len(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(part)
    return lines
