"""The learner's loop around an update that cannot be applied."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples import RUN, rollout, settings

from common.errors import NumericsError
from common.log.reader import LogReader
from common.wire.messages import Snapshot
from common.wire.rollout import Rollout
from services.learner.loop import TrainingLoop
from services.learner.reporting.outlets import open_outlets
from services.learner.resume.plan import Resumption
from services.learner.resume.resumed_replay import ResumedReplay
from services.learner.training.checkpoints import Checkpoints, list_checkpoints, read_checkpoint

SETTINGS = settings(num_envs=2, actors=1)


class TrainerStandIn:
    """A trainer without mathematics, whose update to version 3 fails."""

    version = 0

    def compile(self) -> None:
        """Nothing to compile."""

    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        if self.version == 2:
            raise NumericsError("update 3 made the parameters not finite")
        self.version += 1
        return {}

    def digest(self) -> str:
        return f"d{self.version}"

    def state_arrays(self) -> dict[str, np.ndarray]:
        return {"count": np.array(self.version)}

    policy_arrays = state_arrays


class HubStandIn:
    """A hub whose actor makes every rollout at once; `problem` is what it finds wrong with a policy."""

    def __init__(self, problem: str | None = None) -> None:
        self.problem = problem
        self.version = 0
        self.environments = self.evaluators = self

    def publish(self, snapshot: Snapshot, **_: Any) -> bytes:
        self.version = snapshot.version
        return snapshot.encode()

    def rollouts(self, timeout_s: float) -> list[Rollout] | None:
        return None if self.problem else [rollout(0, "a", self.version, self.version)]

    def policy_problem(self) -> str | None:
        return self.problem

    def divergence(self) -> None:
        return None

    def kept(self) -> None:
        return None

    def fresh(self) -> list[dict[str, Any]]:
        return []

    def engines(self) -> set[str]:
        return {"native"}

    def actors(self) -> int:
        return 1

    def waiting_for(self) -> str:
        return ""

    def open(self) -> None: ...
    def announce(self) -> None: ...
    def drop_silent(self) -> None: ...
    def release_reserved(self) -> None: ...
    def publish_metrics(self, data: bytes) -> None: ...
    def publish_progress(self, progress: object) -> None: ...


def train(run_dir: Path, hub: HubStandIn) -> None:
    given: Any = hub
    trainer: Any = TrainerStandIn()
    stop = threading.Event()
    with open_outlets(RUN, SETTINGS, run_dir, stop) as outlets:
        replay = ResumedReplay(given, Resumption(RUN), outlets.events.add)
        TrainingLoop(SETTINGS, trainer, given, outlets, Checkpoints(RUN, run_dir), replay, stop).train()


def test_the_last_good_version_is_kept(tmp_path: Path) -> None:
    """An update that is not finite ends the run with its reason, the version before it and the command that continues
    without its batch. Policy and state of that version are kept, though none were due."""
    with pytest.raises(NumericsError) as caught:
        train(tmp_path, HubStandIn())
    told = str(caught.value)
    assert told.startswith("update 3 made the parameters not finite. Version 2 is the last good one")
    assert told.endswith(f"reskpn train --resume {tmp_path} --skip-batch")
    (checkpoint,) = list_checkpoints(tmp_path)
    assert read_checkpoint(checkpoint).version == 2
    log = LogReader(tmp_path)
    assert [Snapshot.decode(message.data).version for message in log.messages(["/policy"])] == [2]
    assert [message.json()["version"] for message in log.messages(["/update"])] == [1, 2]


def test_a_policy_that_no_actor_can_act_by_ends_the_run(tmp_path: Path) -> None:
    """With exit code 7, instead of waiting for ever."""
    problem = "3 actors in succession made rollouts with policy 0 whose numbers are not finite"
    with pytest.raises(NumericsError, match=f"{problem}: a smaller algorithm.learning_rate"):
        train(tmp_path, HubStandIn(problem))
