"""Updates in the log and the curves, and the figures that are shown of the run."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
from samples import rollout, settings
from test_scalars import events

from common.log.reader import LogReader
from services.learner.reporting.outlets import open_outlets
from services.learner.reporting.recorder import UpdateRecorder
from services.learner.reporting.statistics import TrainingReturn
from services.learner.reporting.updates import AppliedUpdate


def update(version: int, diverged: tuple[int, int]) -> AppliedUpdate:
    """An update of two rollouts; an episode of return 3 ended in the first."""
    ended = {"episode_return": np.array([3.0], np.float32), "episode_length": np.array([3], np.int32)}
    low = np.full((3, 2), 0.5, np.float32)
    rollouts = [
        rollout(
            0, "a", version - 1, version - 1, reward=np.full((3, 2), 0.5, np.float32), diverged=diverged[0], **ended
        ),
        rollout(1, "b", version - 1, version - 1, reward=low + 1.0, diverged=diverged[1]),
    ]
    return AppliedUpdate(version, 12 * version, f"d{version}", rollouts, {"rkhs/centres": 4.0}, {"wait": 1.0})


def test_what_is_kept_of_an_update(tmp_path: Path) -> None:
    """Episodes before their update, what was shown with it, and diverged simulations: of the update in the log and the
    curves, of the run so far in what is shown. The mean reward is (0.5 + 1.5) / 2 = 1."""
    given = settings()
    with open_outlets("r", given, tmp_path, threading.Event()) as outlets:
        recorder = UpdateRecorder(given, outlets, TrainingReturn(given.updates))
        for version, diverged in ((1, (2, 1)), (2, (0, 1))):
            recorder.count(update(version, diverged))
            recorder.write(update(version, diverged), 60.0, episodes_logged=version == 2)
        # While the run goes on: what is drawn can be looked at.
        points = [(value, step) for name, value, step in events(tmp_path / "tensorboard") if name == "run/diverged"]
        shown = recorder.progress("training", "", 2, 60.0, 2)
    assert (shown.diverged, shown.train_return, shown.step_reward, shown.centres) == (4, 3.0, 1.0, 4)
    assert (shown.env_steps, shown.total_steps) == (24, 120)
    log = LogReader(tmp_path)
    assert [message.topic for message in log.messages(["/episode", "/update"])] == ["/episode", "/update", "/update"]
    records = [message.json() for message in log.messages(["/update"])]
    assert [record["diverged"] for record in records] == [3, 1]
    assert records[0]["progress"] == {"return": 3.0, "step_reward": 1.0, "steps_per_s": 60.0}
    assert points == [(3.0, 12), (1.0, 24)]
