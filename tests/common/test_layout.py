"""Tables and lines that fit a width."""

from __future__ import annotations

import io

from rich.console import Console

from common.layout import Column, FittedTable, Parts, packed

COLUMNS = (Column("name", left=True), Column("much", rank=2), Column("more", rank=1))
ROWS = (("first", "1", "10,000"), ("the second one", "2", "3"))


def test_all_columns_where_there_is_room() -> None:
    """Texts to the left, numbers to the right, two cells between: 14 + 4 + 6 + 4 = 28."""
    assert FittedTable(COLUMNS, ROWS).lines(28) == [
        "name            much    more",
        "first              1  10,000",
        "the second one     2       3",
    ]


def test_the_least_needed_column_goes_first() -> None:
    """One cell less leaves out the one of the highest rank, and seven less the next; the others stay whole."""
    assert FittedTable(COLUMNS, ROWS).lines(27)[0] == "name              more"
    assert FittedTable(COLUMNS, ROWS).lines(21) == ["name", "first", "the second one"]


def test_the_last_way_out_is_to_cut_a_text() -> None:
    """Marked, and never below eight cells."""
    assert FittedTable(COLUMNS, ROWS).lines(10) == ["name", "first", "the secon…"]
    assert FittedTable(COLUMNS, ROWS).lines(3)[2] == "the sec…"


def test_wide_letters_count_twice() -> None:
    """As a terminal shows them."""
    table = FittedTable((Column("a", left=True), Column("b")), (("日本", "1"), ("x", "2")))
    assert table.lines(20) == ["a     b", "日本  1", "x     2"]


def test_a_line_is_broken_between_its_parts() -> None:
    """And not within one, though it be wider than the line."""
    parts = ["update 7/100", "steps 1,000", "return 12.2"]
    assert packed(parts, 40) == ["update 7/100 | steps 1,000 | return 12.2"]
    assert packed(parts, 39) == ["update 7/100 | steps 1,000", "return 12.2"]
    assert packed(parts, 5) == parts


def test_on_a_console() -> None:
    """Both fit its width."""
    output = io.StringIO()
    console = Console(file=output, width=22, highlight=False)
    console.print(FittedTable(COLUMNS, ROWS))
    console.print(Parts(["a" * 12, "b" * 12]))
    assert [line.rstrip() for line in output.getvalue().splitlines()] == [
        "name              more", "first           10,000", "the second one       3", "a" * 12, "b" * 12,
    ]  # fmt: skip
