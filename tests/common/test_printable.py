"""Texts of others on this terminal."""

from __future__ import annotations

import pytest

from common.printable import printable, shortened


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("", ""),
        ("slot 3: host-1 ± é 漢", "slot 3: host-1 ± é 漢"),
        ("\x1b[2J\x1b]0;title\x07", "?[2J?]0;title?"),
        ("a\nb\rc\td\x00\x7f\x9b", "a?b?c?d???"),
        ("right\u202eleft", "right?left"),
    ],
)
def test_what_a_terminal_would_obey_is_not_shown(given: str, shown: str) -> None:
    """Control characters, line ends and turns of direction become question marks; all else stays."""
    assert printable(given) == shown


def test_long_texts_are_cut() -> None:
    """At the limit, which the dots count to."""
    assert printable("x" * 10, 10) == "x" * 10
    assert printable("x" * 11, 10) == "x" * 7 + "..."


def test_the_secret_part_of_an_incarnation_is_not_shown() -> None:
    """Of one that an actor made, 32 hex digits, the first 8; names that were never secret stay."""
    assert shortened("0123456789abcdef" * 2) == "01234567"
    assert shortened("worker-1") == "worker-1"
    assert shortened("x" * 40) == "x" * 40
