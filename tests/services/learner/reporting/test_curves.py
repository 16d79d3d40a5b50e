"""The points of a run's curves, and those that the log of a resumed run has and its curves lack."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from samples import rollout, settings
from test_scalars import events

from common.log.writer import LogWriter
from services.learner.reporting.curves import (
    comparable_settings,
    points_of_evaluation,
    points_of_update,
    restore_points,
)
from services.learner.reporting.scalars import Scalars
from services.learner.reporting.updates import AppliedUpdate


def update(version: int, newest_return: float | None = 8.0) -> dict[str, Any]:
    progress = {"return": newest_return, "step_reward": 0.5, "steps_per_s": 60.0}
    rollouts = [rollout(policy_version=version - 1)]
    return AppliedUpdate(version, 12 * version, "d", rollouts, {"train/kl": 0.25}, {"wait": 1.0}).record(progress)


def evaluation(version: int, source: str) -> dict[str, Any]:
    figures = {"return_mean": 20.0, "return_std": 10.0, "length_mean": 6.0}
    return {"version": version, "env_steps": 12 * version, "source": source, **figures}


def test_the_points_of_an_update() -> None:
    """Metrics, seconds, staleness and what is shown; the handful that matters is in the group that opens first."""
    points = points_of_update(update(3))
    assert points == {
        "train/kl": 0.25,
        "seconds/wait": 1.0,
        "seconds/actor/collect": 0.25,
        "seconds/actor/physics": 0.5,
        "staleness/min": 0,
        "staleness/mean": 0.0,
        "staleness/max": 0,
        "run/diverged": 0,
        "run/return": 8.0,
        "run/step_reward": 0.5,
        "run/steps_per_s": 60.0,
        "charts/return": 8.0,
        "charts/step_reward": 0.5,
        "charts/steps_per_s": 60.0,
        "charts/kl": 0.25,
    }
    assert min(name.split("/")[0] for name in points) == "charts"


def test_an_update_of_an_older_release() -> None:
    """Its log does not have what was shown: no points of that."""
    record = update(3)
    del record["progress"]
    assert "charts/return" not in points_of_update(record)


def test_the_own_evaluation_has_its_own_curves() -> None:
    """So that the last step of `eval/return` has one point, of an evaluator."""
    final = points_of_evaluation(evaluation(9, "run"))
    assert final == {"final/return": 20.0, "final/return_std": 10.0, "final/length": 6.0}
    assert points_of_evaluation(evaluation(9, "evaluator-1"))["charts/eval_return"] == 20.0


def test_points_lost_at_a_kill_are_written_from_the_log(tmp_path: Path) -> None:
    """The curves end at update 2, the log at 4, in its second file: 3 and 4 are added, each point once."""
    scalars = Scalars(tmp_path / "curves")
    for version in (1, 2):
        scalars.add(12 * version, points_of_update(update(version)))
    scalars.add(12, points_of_evaluation(evaluation(1, "evaluator-1")))
    for versions in ((1, 2, 3), (4,)):
        with LogWriter(tmp_path / "run" / "log") as log:
            for version in versions:
                log.write("/update", update(version, None if version == 4 else float(version)))
            log.write("/eval", evaluation(versions[0], "evaluator-2"))
    restore_points(scalars, tmp_path / "run")
    found = [(name, step) for name, _, step in events(tmp_path / "curves")]
    assert [step for name, step in found if name == "run/steps_per_s"] == [12, 24, 36, 48]
    assert [step for name, step in found if name == "charts/return"] == [12, 24, 36]
    assert [step for name, step in found if name == "eval/return"] == [12, 48]
    scalars.close()


def test_only_the_end_of_a_long_log_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of the log before the one in which the curves end are not opened: the first one here is no log at all."""
    scalars = Scalars(tmp_path / "curves")
    scalars.add(24, points_of_update(update(2)))
    for version in (1, 2, 3):
        with LogWriter(tmp_path / "run" / "log") as log:
            log.write("/update", update(version))
    (tmp_path / "run" / "log" / "00000.mcap").write_bytes(b"damaged")
    restore_points(scalars, tmp_path / "run")
    assert scalars.reached("charts/return") == 36
    scalars.close()


def test_a_fresh_run_has_no_points_to_restore(tmp_path: Path) -> None:
    """Its log has nothing, or is not there yet."""
    scalars = Scalars(tmp_path / "curves")
    restore_points(scalars, tmp_path / "run")
    scalars.close()
    assert events(tmp_path / "curves") == []


def test_settings_that_runs_are_compared_by() -> None:
    """How it learns, by dotted names; not where it is kept and how it is reached."""
    found = comparable_settings(settings(seed=4))
    assert (found["seed"], found["algorithm.hidden"], found["algorithm.gamma"]) == (4, "[8, 8]", 0.99)
    assert not [name for name in found if name.startswith(("transport", "log", "run_dir"))]
