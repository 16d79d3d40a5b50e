"""A training run in one process: an actor's collector and the learner's trainer, taking turns.

Policy and rollouts are handed over in memory, so there is no transport, no log and no checkpoint, and the states are
those of a service run with the same settings, bit for bit.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from common.config.settings import RunSettings
from common.maths.policy import Policy
from common.numerical_environment import factorise_on_one_thread
from common.physics import engines
from common.runtime import enable_compilation_cache
from common.wire.rollout import Rollout
from services.actor.collector import Collector, SlotGeneration
from services.actor.rollouts import rollout_message
from services.learner.training.trainer import Trainer
from services.worker.deterministic import evaluate
from services.worker.joining import Assignment
from services.worker.policy_reader import PolicyReader


@dataclass(frozen=True)
class Step:
    """One update: the rollout that it was made from, its metrics, and seconds by phase.

    Phases: `physics` (where it can be told apart), `policy` (the rest of collecting), `learner` and `hand_over`
    (policy to the actor's half, rollout to the learner's).
    """

    version: int
    rollout: Rollout
    metrics: dict[str, float]
    seconds: dict[str, float]


class InProcess:
    """One actor's half and the learner's half of a run."""

    def __init__(self, settings: RunSettings) -> None:
        """Compile everything. `settings.actors` must be 1."""
        self._settings = settings
        self._assignment = Assignment("in-process", 0, 0, "in-process", settings)
        self._trainer = Trainer(settings)
        self._reader = PolicyReader(settings)
        self._collector = Collector(settings, SlotGeneration(slot=0, generation=0), self._reader)
        self._collector.compile()
        self._trainer.compile()

    @property
    def physics(self) -> str:
        """The engine that steps the environments."""
        return self._collector.physics

    @property
    def reader(self) -> PolicyReader:
        return self._reader

    def policy(self) -> Policy:
        """The newest policy."""
        return self._reader.read(self._trainer.policy_arrays())

    def step(self) -> Step:
        """Collect with the newest policy and update on that."""
        began_s = time.perf_counter()
        policy = self.policy()
        collected, timing = self._collector.collect(policy)
        rollout = rollout_message(
            collected, self._assignment, seq=self._collector.seq, version=self._trainer.version, timing=timing
        )
        self._collector.keep()
        collected_s = time.perf_counter()
        metrics = self._trainer.update([rollout])
        seconds = {
            "policy": timing["collect"],
            "learner": time.perf_counter() - collected_s,
            "hand_over": collected_s - began_s - sum(timing.values()),
        }
        if "physics" in timing:
            seconds["physics"] = timing["physics"]
        return Step(self._trainer.version, rollout, metrics, seconds)

    def evaluate(self, episodes: int) -> np.ndarray:
        """Returns [episodes] of the newest policy without exploration."""
        return evaluate(self._settings, self._reader, self.policy(), episodes)[0]

    def digest(self) -> str:
        """Hex digest of the learner's state: that of a service run with the same settings."""
        return self._trainer.digest()


def prepare() -> None:
    """Configure JAX as in a learner and an actor; call this before any computation.

    A learner alone would leave asynchronous dispatch on; its update is as fast without, and gives the same bits.
    """
    factorise_on_one_thread()
    enable_compilation_cache()
    engines.require_synchronous_dispatch()
