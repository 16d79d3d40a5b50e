"""What a run is judged by: episodes, speed, and where the time of an update goes."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from common.wire.messages import Rollout

RECENT_EPISODES = 200


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


@dataclass
class TrainingReturn:
    """Mean return of training episodes: of the newest, and over the last tenth of the run's updates."""

    updates: int
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT_EPISODES))
    late_sum: float = 0.0
    late_count: int = 0
    episodes: int = 0

    def add(self, version: int, episodes: Episodes) -> None:
        self.recent.extend(episodes.returns.tolist())
        self.episodes += len(episodes.returns)
        if version > self.updates - max(1, self.updates // 10):
            self.late_sum += float(episodes.returns.sum())
            self.late_count += len(episodes.returns)

    def recall(self, record: Mapping[str, float]) -> None:
        """Take in an `/episode` record of the log instead, each episode with the mean of them all."""
        count = int(record["count"])
        mean = np.full(count, record["return_mean"], np.float32)
        self.add(int(record["version"]), Episodes(mean, np.ones(count, np.int32)))

    @property
    def newest(self) -> float | None:
        """Mean of the newest episodes (at most 200); None before the first has ended."""
        return sum(self.recent) / len(self.recent) if self.recent else None

    @property
    def late(self) -> float | None:
        """Mean over the last tenth of the updates; None where no episode ended in it."""
        return self.late_sum / self.late_count if self.late_count else None


def step_reward(rollouts: Sequence[Rollout]) -> float:
    """Mean reward of a step of this batch, unscaled: known long before the first episode ends."""
    return float(np.mean([rollout.reward.mean(dtype=np.float64) for rollout in rollouts]))


def actor_seconds(rollouts: Sequence[Rollout]) -> dict[str, float]:
    """Seconds the slowest actor spent on each phase of this batch."""
    phases = {name for rollout in rollouts for name in rollout.timing}
    return {name: max(rollout.timing.get(name, 0.0) for rollout in rollouts) for name in sorted(phases)}
