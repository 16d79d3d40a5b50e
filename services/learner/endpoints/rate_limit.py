"""A limit on how much of something is taken in per second."""

from __future__ import annotations

from collections.abc import Callable


class RateLimit:
    """A token bucket: `burst` may come at once, and `per_s` in the long run."""

    def __init__(self, burst: float, per_s: float, clock_s: Callable[[], float]) -> None:
        self._burst = burst
        self._per_s = per_s
        self._clock_s = clock_s
        self._left = burst
        self._at_s = clock_s()

    def take(self, amount: float) -> bool:
        """Take `amount` if that much is left; returns whether it was."""
        now_s = self._clock_s()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        if amount > self._left:
            return False
        self._left -= amount
        return True
