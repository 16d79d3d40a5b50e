"""The tail of a resumed run's log: what is in it after the checkpoint that the run goes on from."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from common.errors import LogReadError
from common.log.records import LogMessage
from common.wire.messages import Rollout
from services.learner.scheduling.slots import Place, Start

OF_UPDATES = ("/policy", "/episode")


@dataclass(frozen=True)
class LoggedUpdate:
    """One `/update` of the log: the version it led to, the digest of that state, and the rollouts used, in order."""

    version: int
    digest: str
    rollouts: list[Rollout]


class Tail:
    """The updates of the log after a checkpoint, read as they are asked for, and what it holds beyond them.

    Args:
        last: version of the last update in the log.
        updates: those after the checkpoint, in order.
        unused: rollouts that no update has used yet and the next ones may: of version `last` or before it, and of the
            next, for the actors are at work for it while the update to it is still to be recorded.
        ahead: (topic, version) of records that were written ahead of their update, and so must not be written again.
    """

    def __init__(
        self,
        last: int = 0,
        updates: Iterable[LoggedUpdate] = (),
        unused: Sequence[Rollout] = (),
        ahead: Collection[tuple[str, int]] = (),
    ) -> None:
        self.last = last
        self.unused = list(unused)
        self._updates = iter(updates)
        self._ahead = frozenset(ahead)
        self._next: LoggedUpdate | None = None

    def after(self, version: int) -> LoggedUpdate | None:
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
        """What the log holds of a version's rollouts, used or not."""
        if (update := self.after(version)) is not None:
            return update.rollouts
        # Those of older policies, in async mode, wait for the next update as well.
        return [made for made in self.unused if max(made.policy_version, self.last) == version]

    def holds(self, topic: str, version: int) -> bool:
        """Whether the log has that record already. What belongs to an update is written before it."""
        return (topic in OF_UPDATES and version <= self.last) or (topic, version) in self._ahead


def read_updates(messages: Iterable[LogMessage], after: int, staleness: int = 0) -> Iterator[LoggedUpdate]:
    """The updates to versions beyond `after` out of `/rollout` and `/update` messages.

    Args:
        staleness: versions that a rollout may lie behind the policy that it updates.

    Raises:
        LogReadError: an update names a rollout that is not before it.
        CodecError: a rollout is not one.
    """
    waiting: dict[Place, Rollout] = {}
    for message in messages:
        if message.topic == "/rollout":
            rollout = Rollout.decode(message.data)
            if rollout.policy_version >= after - staleness:
                waiting[rollout.place] = rollout
            continue
        update = message.json()
        if update["version"] <= after:
            continue
        places = [place_of(used) for used in update["rollouts"]]
        if missing := [place for place in places if place not in waiting]:
            raise LogReadError(
                f"update {update['version']} names rollout {missing[0][2]} of slot {missing[0][0]}, which is not in "
                "the log before it; restore the log from a copy"
            )
        yield LoggedUpdate(update["version"], update["state_digest"], [waiting.pop(place) for place in places])
        for place, rollout in list(waiting.items()):
            if rollout.policy_version < update["version"] - staleness:
                del waiting[place]  # no update can use it any more


def place_of(used: dict[str, int]) -> Place:
    """The place of a rollout as `/update` names it."""
    return used["slot"], used["generation"], used["seq"]


def divergence(
    starts: Sequence[Start], updates: Sequence[Collection[Place]], unused: Sequence[Collection[Place]], version: int
) -> str | None:
    """Why acting again from `starts` cannot make the rollouts of the log; None where it can.

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
