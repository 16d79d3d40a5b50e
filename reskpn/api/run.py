"""`reskpn.open_run`: a recorded run as arrays, records and policies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.config.settings import RunSettings
from common.errors import ReskpnError, SettingsError
from common.runs.listing import describe_run, read_summary
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import RecordedUpdate

if TYPE_CHECKING:
    import pandas as pd

    from reskpn.export.policy import TrainedPolicy
    from reskpn.viewing.footage import Take


def open_run(path: str | Path) -> Run:
    """The run in a directory: finished, running or killed.

    Raises:
        LogReadError: there is no log, or it is damaged.
    """
    return Run(Path(path))


class Run:
    """A recorded run as it was when it was opened. Its log is read when something is asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._recorded = RecordedRun(path)

    def __repr__(self) -> str:
        settings = self.settings
        return f"<reskpn.Run {self.name}: {settings.learner} on {settings.task}, version {self.version}, {self.state}>"

    @property
    def name(self) -> str:
        """The run's id, as its log and its figures have it."""
        return self._recorded.run

    @property
    def settings(self) -> RunSettings:
        """Every setting of the run: `run.settings.algorithm.gamma`."""
        return self._recorded.settings

    @property
    def summary(self) -> dict[str, Any] | None:
        """The figures of `summary.json`; None before the run ended."""
        return read_summary(self.path)

    @property
    def state(self) -> str:
        """finished, running, stopped (it can be resumed), or starting; of a log without its directory: recorded."""
        listed = describe_run(self.path) if self.path.is_dir() else None
        return "recorded" if listed is None else listed.state

    @property
    def version(self) -> int:
        """Updates made, which is the newest version of the policy."""
        return self._recorded.count_updates()

    def curves(self) -> dict[str, np.ndarray]:
        """Every figure of the updates as an array with one number for each update, NaN where it is not known.

        `version`, `env_steps`, `return` (of the newest training episodes), `reward` (mean of a step), metrics such as
        `train/kl`, and `seconds/...` of each phase.
        """
        rows = [_row(record) for record in self._records("/update")]
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: _column([row.get(name) for row in rows], name) for name in names}

    def frame(self) -> pd.DataFrame:
        """The curves as a pandas DataFrame with the version as its index. ReskpnError where pandas is not installed."""
        try:
            import pandas as pd
        except ImportError:
            raise ReskpnError(
                "frames need pandas, which is not installed: pip install 'reskpn[frames]'; curves() needs NumPy alone"
            ) from None
        curves = self.curves()
        return pd.DataFrame(curves).set_index("version") if curves else pd.DataFrame()

    def episodes(self) -> list[dict[str, Any]]:
        """The training episodes that ended, a record for each update in which some did (docs/architecture.md)."""
        return [dict(record) for record in self._records("/episode")]

    def evaluations(self) -> list[dict[str, Any]]:
        """The evaluations, the run's own and those of evaluators: version, env_steps, return_mean and on."""
        return [dict(record) for record in self._recorded.evaluations()]

    def trajectories(self, *, diverged: bool = False) -> list[Take]:
        """The logged trajectories of evaluations, or of simulations that diverged.

        Each has `version`, `episode`, `source`, `step_s`, and in `motion` the arrays `qpos`, `qvel`, `action` and
        `reward` by step.

        Raises:
            LogReadError: the log is damaged, or from before trajectories had a model.
        """
        from reskpn.viewing.footage import read_footage

        footage = read_footage(self.path)
        return list(footage.diverged if diverged else footage.evaluated)

    def updates(self) -> Iterator[RecordedUpdate]:
        """The updates with the rollouts that they were made from, read as they are asked for."""
        return self._recorded.updates()

    def versions(self) -> list[int]:
        """The versions whose policies are in the log; others are recomputed when they are asked for."""
        return [snapshot.version for snapshot in self._recorded.policies()]

    def policy(self, version: int | None = None, *, task: str | None = None) -> RunPolicy:
        """The policy of a version; for None the newest that the log holds.

        Args:
            task: for a run on a class of one's own its `module:Class`, which is imported only if it is named here.

        Raises:
            SettingsError: the run has no such version.
        """
        from reskpn.commands.task_option import confirm_task
        from reskpn.export.policy import trained_policy

        confirm_task(self.settings, task)
        return RunPolicy(self._recorded, trained_policy(self._recorded, version))

    def _records(self, topic: str) -> Iterator[Mapping[str, Any]]:
        return self._recorded.records(topic)


class RunPolicy:
    """A policy of a run, without exploration; actions are clipped as the environment clips them."""

    def __init__(self, recorded: RecordedRun, policy: TrainedPolicy) -> None:
        import jax

        self._recorded = recorded
        self._policy = policy
        self._act = jax.jit(policy.function())

    @property
    def version(self) -> int:
        return self._policy.version

    @property
    def digest(self) -> str:
        """Of the policy's arrays."""
        return self._policy.digest

    @property
    def arrays(self) -> Mapping[str, np.ndarray]:
        """The policy's arrays by path: parameters, expansion and moments of the observations."""
        return self._policy.arrays

    def act(self, observation: np.ndarray | Sequence[float]) -> np.ndarray:
        """The action [A] for an observation [O], or [B, A] for [B, O]; float32, each number in [-1, 1].

        Raises:
            SettingsError: the observation has another shape.
        """
        given = np.asarray(observation, np.float32)
        size = self._policy.settings.sizes.observation_size
        if given.ndim not in (1, 2) or given.shape[-1] != size:
            raise SettingsError(
                f"an observation of shape {list(given.shape)}; this policy takes [{size}], or [B, {size}] for several"
            )
        actions = np.asarray(self._act(np.atleast_2d(given)))
        return actions[0] if given.ndim == 1 else actions

    def export(self, path: str | Path) -> Path:
        """Write the policy as `reskpn export` does: `.onnx`, or `.npz` for JAX. Returns the path.

        Raises:
            SettingsError: the file cannot be written, or its name has another ending.
            NumericsError: it does not act as this policy does; nothing is left of it.
        """
        from reskpn.export.verify import logged_observations
        from reskpn.export.write import format_of, write_policy

        path = Path(path)
        return write_policy(self._policy, logged_observations(self._recorded), format_of(path), path).path


def _row(record: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of one update by name."""
    progress = record.get("progress") or {}
    row = {"version": record["version"], "env_steps": record["env_steps"]}
    row |= {"return": progress.get("return"), "reward": progress.get("step_reward")}
    row |= {"steps_per_s": progress.get("steps_per_s")}
    row |= dict(record["metrics"])
    return row | {f"seconds/{name}": value for name, value in record["seconds"].items()}


def _column(values: Sequence[Any], name: str) -> np.ndarray:
    if name in ("version", "env_steps"):
        return np.array(values, np.int64)
    return np.array([np.nan if value is None else value for value in values], np.float64)
