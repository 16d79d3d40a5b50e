"""The figures a run is judged by: returns of episodes, rewards, and the seconds of an update."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from common.runs.tally import RECENT_EPISODES, late_from
from common.wire.rollout import Rollout


@dataclass(frozen=True)
class Episodes:
    """The episodes that ended in one batch."""

    returns: np.ndarray
    lengths: np.ndarray

    @classmethod
    def of(cls, rollouts: Sequence[Rollout]) -> Episodes:
        return cls(
            np.concatenate([rollout.episode_return for rollout in rollouts]),
            np.concatenate([rollout.episode_length for rollout in rollouts]),
        )

    def record(self, version: int) -> dict[str, float] | None:
        """The `/episode` message, or None where no episode ended."""
        if not len(self.returns):
            return None
        return {
            "version": version,
            "count": len(self.returns),
            "return_mean": float(self.returns.mean()),
            "return_min": float(self.returns.min()),
            "return_max": float(self.returns.max()),
            "length_mean": float(self.lengths.mean()),
        }


@dataclass(frozen=True)
class _Ended:
    """The episodes that ended in one update: how many, and their mean return."""

    count: int
    mean: float


@dataclass
class TrainingReturn:
    """Mean return of training episodes: of the newest, and over the last tenth of the run's updates.

    Episodes are kept as the count and mean of each update, which is what the log has of them: so a resumed run shows
    the figures that it would have shown without the interruption.
    """

    updates: int
    recent: deque[_Ended] = field(default_factory=deque)
    late_sum: float = 0.0
    late_count: int = 0
    episodes: int = 0

    def add(self, version: int, episodes: Episodes) -> None:
        """Take in the episodes that ended in the update to that version."""
        record = episodes.record(version)
        if record is not None:
            self.recall(record)

    def recall(self, record: Mapping[str, float]) -> None:
        """Take in an `/episode` record."""
        ended = _Ended(int(record["count"]), float(record["return_mean"]))
        self.recent.append(ended)
        # Whole updates only. Within an update episodes come slot by slot, each slot's in the order in which they
        # ended, so the last 200 of them would be those of the last slot that took longest.
        while sum(kept.count for kept in self.recent) - self.recent[0].count >= RECENT_EPISODES:
            self.recent.popleft()
        self.episodes += ended.count
        if record["version"] >= late_from(self.updates):
            self.late_sum += ended.count * ended.mean
            self.late_count += ended.count

    @property
    def newest(self) -> float | None:
        """Mean of the newest updates' episodes, as many updates as have 200; None before the first has ended."""
        if not self.recent:
            return None
        return sum(ended.count * ended.mean for ended in self.recent) / sum(ended.count for ended in self.recent)

    @property
    def late(self) -> float | None:
        """Mean over the last tenth of the updates; None where no episode ended in it."""
        return self.late_sum / self.late_count if self.late_count else None


def step_reward(rollouts: Sequence[Rollout]) -> float:
    """Mean reward of a step of this batch, unscaled: known long before the first episode ends."""
    return float(np.mean([rollout.reward.mean(dtype=np.float64) for rollout in rollouts]))


def actor_seconds(rollouts: Sequence[Rollout]) -> dict[str, float]:
    """Seconds that the slowest actor spent on each phase of this batch."""
    phases = {name for rollout in rollouts for name in rollout.timing}
    return {name: max(rollout.timing.get(name, 0.0) for rollout in rollouts) for name in sorted(phases)}
