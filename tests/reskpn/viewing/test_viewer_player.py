"""Playback: time, choice and speed."""

from __future__ import annotations

import pytest
from logs import motion

from reskpn.viewing.footage import Take
from reskpn.viewing.player import FASTEST, Player

SHORT = Take(0, 0, "evaluator-e1", 0.5, motion(5))
"""Two seconds from the first state to the last."""
LONG = Take(20, 0, "run", 0.5, motion(9))
OTHER = Take(20, 1, "run", 0.5, motion(3))


@pytest.fixture
def player() -> Player:
    return Player([SHORT, LONG, OTHER])


def test_time_passes_and_the_take_repeats(player: Player) -> None:
    """1.1 s are step 2 of half a second; rewards 0 and 1 came before it. After 2 s it starts again."""
    player.advance(1.1)
    now = player.position()
    assert (now.step, now.reward, now.total) == (2, 2.0, 1.0)
    player.advance(1.0)
    assert player.position().step == 0


def test_speed_is_simulated_time_per_time(player: Player) -> None:
    """At a quarter of the speed, 4 s are one; beyond the fastest it is the fastest."""
    player.set_speed(0.25)
    player.advance(4.0)
    assert player.position().step == 2
    player.set_speed(1e9)
    assert player.position().speed == FASTEST


def test_seeking_stays_there(player: Player) -> None:
    """Within the take, until it is played on."""
    player.seek(99)
    player.advance(10.0)
    assert (player.position().step, player.position().playing) == (4, False)
    player.seek(-1)
    assert player.position().step == 0
    player.play(True)
    player.advance(0.5)
    assert player.position().step == 1


def test_another_take_begins_at_its_beginning(player: Player) -> None:
    """The takes of a version are found by it."""
    player.advance(1.0)
    assert player.versions == [0, 20]
    assert player.episodes(20) == [LONG, OTHER]
    player.choose(LONG)
    assert (player.position().take, player.position().step) == (LONG, 0)
