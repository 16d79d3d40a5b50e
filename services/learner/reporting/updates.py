"""One applied update, as the log and the curves have it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from common.wire.rollout import Rollout
from services.learner.reporting.statistics import actor_seconds


@dataclass(frozen=True)
class AppliedUpdate:
    """One update and what went into it.

    Attributes:
        version: the version it led to; env_steps: environment steps up to there.
        digest: of the state it led to.
        loop_seconds: the learner's seconds by phase; "log" ran beside the others.
    """

    version: int
    env_steps: int
    digest: str
    rollouts: Sequence[Rollout]
    metrics: Mapping[str, float]
    loop_seconds: Mapping[str, float]

    @property
    def staleness(self) -> dict[str, float]:
        """Versions between the policies that made the rollouts and the one that was updated: min, mean, max."""
        behind = [self.version - 1 - rollout.policy_version for rollout in self.rollouts]
        return {"min": min(behind), "mean": sum(behind) / len(behind), "max": max(behind)}

    @property
    def diverged(self) -> int:
        """Simulations that diverged in the rollouts."""
        return sum(rollout.diverged for rollout in self.rollouts)

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds by phase: the learner's, and as `actor/...` the slowest actor's."""
        actors = actor_seconds(self.rollouts)
        return {**self.loop_seconds, **{f"actor/{name}": value for name, value in actors.items()}}

    def record(self, progress: Mapping[str, float | None]) -> dict[str, Any]:
        """The `/update` message, with the figures that are shown at this update; None where one is not known.

        Incarnations are whole, so it is for the log alone.
        """
        return {
            "version": self.version,
            "env_steps": self.env_steps,
            "rollouts": [
                {
                    "slot": rollout.slot,
                    "incarnation": rollout.incarnation,
                    "generation": rollout.generation,
                    "seq": rollout.seq,
                    "policy_version": rollout.policy_version,
                }
                for rollout in self.rollouts
            ],
            "state_digest": self.digest,
            "metrics": dict(self.metrics),
            "seconds": self.seconds,
            "staleness": self.staleness,
            "diverged": self.diverged,
            "progress": dict(progress),
        }
