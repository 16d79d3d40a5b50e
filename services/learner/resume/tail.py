"""The tail of a resumed run's log: its content after the checkpoint that the run is restored from."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from common.errors import LogReadError
from common.runs.recorded_updates import RecordedUpdate
from common.wire.rollout import Rollout, RolloutId
from services.learner.scheduling.slots import Start

OF_UPDATES = ("/policy", "/episode")


class Tail:
    """The updates of the log after a checkpoint, read as they are asked for, and its records beyond them.

    Args:
        last: version of the last update in the log.
        updates: those after the checkpoint, in order.
        unused: rollouts that no update has used yet and the next ones may: of version `last` or before it, and of the
            next, since actors start on it while the update to it is still to be recorded.
        ahead: (topic, version) of records that were written ahead of their update, and so must not be written twice.
    """

    def __init__(
        self,
        last: int = 0,
        updates: Iterable[RecordedUpdate] = (),
        unused: Sequence[Rollout] = (),
        ahead: Collection[tuple[str, int]] = (),
    ) -> None:
        self.last = last
        self.unused = list(unused)
        self._updates = iter(updates)
        self._ahead = frozenset(ahead)
        self._next: RecordedUpdate | None = None

    def after(self, version: int) -> RecordedUpdate | None:
        """The update of that version to the next, or None where the log has none. Versions must not decrease.

        Raises:
            LogReadError: the log is damaged, or lacks an update before its last.
        """
        while version < self.last and (self._next is None or self._next.version <= version):
            self._next = next(self._updates, None)
            if self._next is None:
                raise LogReadError(
                    f"the log has no update {version + 1}, but one to {self.last}; restore it from a copy"
                )
        return self._next if version < self.last else None

    def rollouts(self, version: int) -> list[Rollout]:
        """The logged rollouts of a version, used or not."""
        if (update := self.after(version)) is not None:
            return update.rollouts
        # Those of older policies, in async mode, wait for the next update as well.
        return [made for made in self.unused if max(made.policy_version, self.last) == version]

    def holds(self, topic: str, version: int) -> bool:
        """True if the log has that record already."""
        # The records of an update are written before its /update, so the last update vouches for them.
        return (topic in OF_UPDATES and version <= self.last) or (topic, version) in self._ahead


def divergence(
    starts: Sequence[Start],
    updates: Sequence[Collection[RolloutId]],
    unused: Sequence[Collection[RolloutId]],
    version: int,
) -> str | None:
    """The reason why acting from `starts` cannot reproduce the rollouts of the log; None where it can.

    Args:
        updates: places of the rollouts of each update, from `version` on.
        unused: those of the rollouts after them, by version.
    """
    for count, places in enumerate([*updates, *unused]):
        expected = {(slot, start.generation, start.seq + count) for slot, start in enumerate(starts)}
        complete = count >= len(updates) or len(places) == len(expected)
        if not complete or not set(places) <= expected:
            return f"version {version + count} of the run was not acted by one and the same actor in every slot"
    return None
