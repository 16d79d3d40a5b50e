"""The rollouts that were read and may still be used: boundedly many, for use comes soon after logging."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from common.errors import LogReadError
from common.wire.messages import Rollout

BATCHES = 8
"""Batches of rollouts that are kept for use; a learner keeps no more than a few."""

Key = tuple[int, str, int]


class Window:
    """Rollouts by (slot, incarnation, seq) between their place in the log and their use.

    Args:
        batch: rollouts of one update.
        on_unused: called with each rollout that leaves without having been used.
    """

    def __init__(self, batch: int, on_unused: Callable[[Rollout], None]) -> None:
        self._room = BATCHES * batch
        self._on_unused = on_unused
        self._rollouts: dict[Key, Rollout] = {}

    def add(self, rollout: Rollout) -> None:
        """Put in the newest rollout. Where there is no room, the oldest leaves.

        Raises:
            LogReadError: the same rollout is there already.
        """
        if rollout.key in self._rollouts:
            raise LogReadError(f"the log holds the {_name(rollout.key)} twice; it is not as a learner writes it")
        self._rollouts[rollout.key] = rollout
        if len(self._rollouts) > self._room:
            self._on_unused(self._rollouts.pop(next(iter(self._rollouts))))

    def take(self, version: int, keys: Sequence[Key]) -> list[Rollout]:
        """Take out the rollouts that update `version` used, in the order of `keys`.

        Raises:
            LogReadError: one is not there.
        """
        for key in keys:
            if key not in self._rollouts:
                raise LogReadError(
                    f"update {version} names the {_name(key)}, which is not among the {self._room} rollouts in the "
                    "log before it, or was used before; restore the log from a copy"
                )
        return [self._rollouts.pop(key) for key in keys]

    def end(self) -> None:
        """All rollouts that are left were not used."""
        while self._rollouts:
            self._on_unused(self._rollouts.pop(next(iter(self._rollouts))))


def _name(key: Key) -> str:
    slot, incarnation, seq = key
    return f"rollout of slot {slot}, incarnation {incarnation}, seq {seq}"
