"""The rollouts read from a log that an update may still use: a bounded number, for use comes soon after logging."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from common.errors import LogReadError
from common.wire.rollout import Rollout

BATCHES = 8
"""Batches of rollouts that are kept for use; a learner keeps no more than a few."""

Key = tuple[int, str, int]


class RolloutWindow:
    """Rollouts by (slot, incarnation, seq) between their place in the log and their use.

    Args:
        batch: rollouts of one update.
        on_unused: called with each rollout that leaves without having been used.
    """

    def __init__(self, batch: int, on_unused: Callable[[Rollout], None]) -> None:
        self._capacity = BATCHES * batch
        self._on_unused = on_unused
        self._rollouts: dict[Key, Rollout] = {}

    def add(self, rollout: Rollout) -> None:
        """Add the newest rollout; the oldest leaves where the window is full.

        Raises:
            LogReadError: the same rollout is there already.
        """
        if rollout.key in self._rollouts:
            raise LogReadError(f"the log holds the {_name(rollout.key)} twice; it is not as a learner writes it")
        self._rollouts[rollout.key] = rollout
        if len(self._rollouts) > self._capacity:
            self._on_unused(self._rollouts.pop(next(iter(self._rollouts))))

    def take(self, version: int, keys: Sequence[Key]) -> list[Rollout]:
        """Remove and return the rollouts that update `version` used, in the order of `keys`.

        Raises:
            LogReadError: one is not there.
        """
        for key in keys:
            if key not in self._rollouts:
                raise LogReadError(
                    f"update {version} names the {_name(key)}, which is not among the {self._capacity} rollouts in the "
                    "log before it, or was used before; restore the log from a copy"
                )
        return [self._rollouts.pop(key) for key in keys]

    def discard(self, keys: Sequence[Key]) -> None:
        """Remove rollouts that an update used which is not read itself, as far as they are there."""
        for key in keys:
            self._rollouts.pop(key, None)

    def close(self) -> None:
        """End of the log: all rollouts that are left were not used."""
        while self._rollouts:
            self._on_unused(self._rollouts.pop(next(iter(self._rollouts))))


def _name(key: Key) -> str:
    slot, incarnation, seq = key
    return f"rollout of slot {slot}, incarnation {incarnation}, seq {seq}"
