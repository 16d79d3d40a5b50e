"""Where a log was made against where it is replayed."""

from __future__ import annotations

import pytest

from common.runs.origins import Difference, bits_can_differ, differences, origin

HERE = origin("abc", {"jax": "0.10.2", "python": "3.11.7", "brax": "1"}, {"cpu": "A", "cores": "2", "host": "here"})


def test_the_same_place() -> None:
    """Nothing differs; the host's name and packages that no update uses do not count."""
    assert differences([HERE, HERE], HERE) == []
    assert differences([HERE | {"host": "there", "brax": "2"}], HERE) == []
    assert not bits_can_differ([])


def test_differences_are_told_once() -> None:
    """Of any segment, with both values; what a log does not say is not assumed."""
    moved = HERE | {"cpu": "B", "commit": "def"}
    found = differences([HERE, moved, moved], HERE)
    assert found == [Difference("cpu", "B", "A"), Difference("commit", "def", "abc")]
    assert str(found[0]) == "cpu: B in the log, A here"
    silent = {name: value for name, value in HERE.items() if name != "jax"}
    assert differences([silent], HERE) == [Difference("jax", "not recorded", "0.10.2")]


@pytest.mark.parametrize(
    ("name", "excused"),
    [
        ("jax", True),
        ("jaxlib", True),
        ("cpu", True),
        ("cores", True),
        ("devices", True),
        ("commit", False),
        ("reskpn", False),
        ("python", False),
        ("numpy", False),
    ],
)
def test_what_excuses_other_bits(name: str, excused: bool) -> None:
    """What compiles and runs an update does; this project's own code does not."""
    assert bits_can_differ(differences([HERE | {name: "another"}], HERE)) is excused
