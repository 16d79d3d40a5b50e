"""The replay of a resumed run's tail: the logged updates are made once more, and compared.

The actors act again, from the environments of the restore point, so that theirs end where the log ends, too. Where
their rollouts differ from those logged, the rest of the tail is replayed without them, and every slot begins with new
environments: the state of its own is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from common.wire.rollout import Rollout
from services.learner.endpoints.hub import Hub
from services.learner.reporting.statistics import TrainingReturn
from services.learner.resume.plan import Resumption


@dataclass(frozen=True)
class Remaining:
    """The rollouts that a resumed run still has to collect with one version of its policy.

    Attributes:
        collect: True if rollouts are collected at all.
        hand_in: True if actors may be asked for the states of their environments; those of the restore point are kept.
        logged: rollouts in the log that are made again and compared.
        settled: rollouts in the log that are not made again.
    """

    collect: bool
    hand_in: bool
    logged: Collection[Rollout]
    settled: Collection[Rollout]


class ResumedReplay:
    """The loop's view of the log that the run goes on from; for a new run, whose log is empty, it covers nothing.

    Args:
        on_event: as the hub's.
    """

    def __init__(self, hub: Hub, resumption: Resumption, on_event: Callable[[str, str, str], None]) -> None:
        self._hub = hub
        self._resumption = resumption
        self._tail = resumption.tail
        self._on_event = on_event
        self._acting = resumption.log_only_reason is None
        self._digests: dict[int, str] = {}
        self._diverged = False
        if resumption.log_only_reason is not None:
            on_event(
                "info",
                "resumed_by_log",
                f"the log's last updates are made without acting: {resumption.log_only_reason}",
            )

    def returns(self, updates: int) -> TrainingReturn:
        """The training returns of a run of so many updates, up to the restore point."""
        returns = TrainingReturn(updates, episodes=self._resumption.earlier_episodes)
        for record in self._resumption.episodes:
            returns.recall(record)
        return returns

    def covers(self, version: int) -> bool:
        """True if the log has the update of that version to the next."""
        return version < self._tail.last

    def holds(self, topic: str, version: int) -> bool:
        """True if the log has that record already."""
        return self._tail.holds(topic, version)

    def reaches(self, version: int) -> bool:
        """True if the log affects the rollouts that are collected with a version; never in a fresh run."""
        # Actors work for the version after the last update before that update is recorded: hence one more.
        return bool(self._tail.last or self._tail.unused) and version <= self._tail.last + 1

    def remaining(self, version: int) -> Remaining:
        """The rollouts of a version that are still to be collected. Versions must not decrease."""
        last = self._tail.last
        logged = self._tail.rollouts(version)
        if (update := self._tail.after(version)) is not None:
            self._digests[update.version] = update.state_digest
        collect = self._acting or version >= last
        restored = self._acting and version == self._resumption.version
        return Remaining(
            collect=collect,
            hand_in=collect and not restored,
            logged=logged if self._acting else (),
            settled=() if self._acting or version < last else logged,
        )

    def logged_rollouts(self, version: int) -> list[Rollout] | None:
        """The rollouts to update that version with, where they are the log's and nobody acts; else None."""
        return None if self._acting or not self.covers(version) else self._tail.rollouts(version)

    def fall_back_to_log(self, version: int) -> bool:
        """Replay the rest of the tail from the log alone if acting has diverged from it; returns True if so."""
        divergence = self._hub.divergence()
        if divergence is None:
            return False
        self._acting = False
        self._on_event(
            "warning",
            "resumed_differs",
            f"acting again does not give what is in the log: {divergence}. The updates up to {self._tail.last} are "
            "made from the log, and every slot goes on with new environments: the run is whole, but not bit for bit "
            "the one that was not interrupted",
        )
        collect = version >= self._tail.last
        self._hub.start_over(
            self._resumption.fresh_starts, self._tail.rollouts(version) if collect else (), collect=collect
        )
        return True

    def check(self, version: int, digest: str) -> None:
        """Compare the state's digest with the logged one; the first divergence is reported as an event."""
        logged = self._digests.pop(version, digest)
        if logged != digest and not self._diverged:
            self._diverged = True
            self._on_event(
                "warning",
                "resumed_state_differs",
                f"update {version}, made again from the same rollouts, led to digest {digest} where the log has "
                f"{logged}: another machine or other versions than those in its /spec; the run goes on from what was "
                "made here",
            )
