"""Playback of trajectories: which one, where in it, and how fast. Shared by two threads, and without a picture."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

from reskpn.viewing.footage import Take

SLOWEST, FASTEST = 0.05, 4.0
"""Simulated seconds per second that the viewer offers."""


@dataclass(frozen=True)
class Position:
    """The step that is shown at a moment."""

    take: Take
    step: int
    playing: bool
    speed: float
    reward: float
    """Of the step that follows."""
    total: float
    """Sum of the rewards up to here."""


class Player:
    """Plays one of several takes, and repeats it until told otherwise.

    Args:
        takes: at least one.
        at: index of the take to begin with.
    """

    def __init__(self, takes: Sequence[Take], at: int = 0, speed: float = 1.0) -> None:
        self._lock = threading.Lock()
        self._takes = list(takes)
        self._at = at
        self._time_s = 0.0
        self._playing = True
        self._speed = speed

    @property
    def takes(self) -> list[Take]:
        """All takes that can be chosen."""
        return list(self._takes)

    @property
    def versions(self) -> list[int]:
        """The versions of the policy that can be chosen, in order."""
        return sorted({take.version for take in self._takes})

    def episodes(self, version: int) -> list[Take]:
        """The takes of one version."""
        return [take for take in self._takes if take.version == version]

    def advance(self, seconds: float) -> None:
        """Let that much time pass."""
        with self._lock:
            if self._playing:
                take = self._takes[self._at]
                self._time_s += seconds * self._speed
                if self._time_s > take.seconds:
                    self._time_s = 0.0

    def position(self) -> Position:
        """The step that is shown now."""
        with self._lock:
            take = self._takes[self._at]
            step = min(round(self._time_s / take.step_s), take.motion.steps - 1)
            rewards = take.motion.reward
            total = float(rewards[:step].sum())
            return Position(take, step, self._playing, self._speed, float(rewards[step]), total)

    def choose(self, take: Take) -> None:
        """Play another take from its beginning."""
        with self._lock:
            self._at = self._takes.index(take)
            self._time_s = 0.0

    def seek(self, step: int) -> None:
        """Show a step, and stay there."""
        with self._lock:
            take = self._takes[self._at]
            self._time_s = min(max(0, step), take.motion.steps - 1) * take.step_s
            self._playing = False

    def play(self, playing: bool) -> None:
        """Play on, or stay."""
        with self._lock:
            self._playing = playing

    def set_speed(self, speed: float) -> None:
        """Play at `speed` simulated seconds per second, as far as the viewer offers it."""
        with self._lock:
            self._speed = min(max(speed, SLOWEST), FASTEST)
