"""Trajectories of evaluations: checked against the run on admission, and logged within the run's allowance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from common.config.settings import RunSettings
from common.errors import CodecError
from common.log.writer import LogWriter
from common.physics.state_shapes import state_shapes
from common.tasks import Task
from common.wire.motion import Motions, unpack


def motion_sizes(task: Task) -> tuple[int, int, int]:
    """The numbers of joint positions, joint velocities and actions of a task."""
    shapes = state_shapes(task, 1)
    return shapes["bodies/q"][1][1], shapes["bodies/qd"][1][1], task.action_size


class MotionLog:
    """Takes the trajectories that come with evaluations.

    Args:
        logged: records of trajectories that the log of a resumed run has already.
    """

    def __init__(self, run: str, settings: RunSettings, log: LogWriter, logged: int = 0) -> None:
        self._run = run
        self._evaluation = settings.evaluation
        self._sizes = motion_sizes(settings.sizes)
        self._log = log
        self._left = self._evaluation.trajectory_records - logged

    def read(self, packed: np.ndarray, version: int, lengths: np.ndarray) -> Motions | None:
        """The motions that came with an evaluation of episodes of these `lengths` [e]; None for none.

        Raises `CodecError`: as `Motions.decode`; `run` or `bad_value` where they are not of this evaluation;
        `bad_shape` for other sizes than the task's, or more episodes or steps than there are.
        """
        motions = unpack(packed)
        if motions is None:
            return None
        if motions.run != self._run or motions.version != version:
            raise CodecError("bad_value", f"motions of version {motions.version} came with version {version}")
        allowed = min(self._evaluation.trajectories, len(lengths))
        if len(motions.lengths) > allowed or (motions.lengths > lengths[: len(motions.lengths)]).any():
            raise CodecError(
                "bad_shape",
                f"motions of {len(motions.lengths)} episodes; allowed: the first {allowed} of the evaluation, whole or "
                "cut",
            )
        sizes = motions.qpos.shape[1], motions.qvel.shape[1], motions.action.shape[1]
        if sizes != self._sizes:
            raise CodecError("bad_shape", f"motions of sizes {sizes}; the task has {self._sizes}")
        return motions

    def write(self, motions: Motions | None, source: str) -> None:
        """Log the motions of an evaluator, unless the run's allowance is used up."""
        if motions is not None and self._left > 0:
            self._left -= 1
            self._log.write("/motion", replace(motions, source=source).encode())
