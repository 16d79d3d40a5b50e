"""Processes that make runs: kept for the next run, ended with one that fails."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from common.config.settings import RunSettings
from common.errors import LogWriteError, ProcessError
from reskpn.study.experiments import Experiment
from reskpn.study.planning import Trial, plan
from reskpn.study.run_process import Warm
from reskpn.study.running import Work
from reskpn.study.store import Store

STAND_IN = """
import json, os, sys
for line in sys.stdin:
    order = json.loads(line)
    learner = json.loads(order["settings"])["learner"]
    print("a library's own words", json.dumps({"update": 2, "updates": 3, "return": None}), sep="\\n", flush=True)
    if order["path"].endswith("full"):
        sys.exit(print("no space left", file=sys.stderr) or 5)
    if order["path"].endswith("gone"):
        sys.exit(0)
    open(order["path"], "w").write(f"{learner} {os.getpid()}")
    print(json.dumps({"finished": True}), flush=True)
"""


@pytest.fixture
def warm() -> Iterator[Warm]:
    with closing(Warm((sys.executable, "-c", STAND_IN))) as processes:
        yield processes


@pytest.fixture
def trial(catalogue: dict[str, Experiment], store: Store) -> Trial:
    return plan(catalogue["widths"], "smoke", catalogue, store).trials[0]


def made_by(warm: Warm, settings: RunSettings, path: Path, trial: Trial) -> list[str]:
    work = Work(trial)
    warm(settings, path, work)
    assert work.steps == 2 * settings.batch_size
    return path.read_text().split()


def test_one_process_makes_one_run_after_another(warm: Warm, trial: Trial, tmp_path: Path) -> None:
    """It gets the settings of each."""
    learner, process = made_by(warm, trial.settings, tmp_path / "1", trial)
    other = trial.settings.model_copy(update={"learner": "ppo"})
    assert made_by(warm, other, tmp_path / "2", trial) == ["ppo", process]
    assert learner == trial.settings.learner


@pytest.mark.parametrize(
    ("end", "error", "said"),
    [("full", LogWriteError, "no space left"), ("gone", ProcessError, "ended with code 0 before the run was finished")],
)
def test_a_run_that_fails_ends_its_process(
    warm: Warm, trial: Trial, tmp_path: Path, end: str, error: type[Exception], said: str
) -> None:
    """The next run has another one."""
    _, first = made_by(warm, trial.settings, tmp_path / "1", trial)
    with pytest.raises(error, match=said):
        warm(trial.settings, tmp_path / end, Work(trial))
    _, second = made_by(warm, trial.settings, tmp_path / "2", trial)
    assert second != first


def test_a_process_that_was_stopped_is_an_error(warm: Warm, trial: Trial, tmp_path: Path) -> None:
    """As a queue that is stopped leaves it; the next run has another one."""
    work = Work(trial)
    warm(trial.settings, tmp_path / "1", work)
    work.stop()
    assert work.process is not None
    work.process.wait()
    with pytest.raises(ProcessError, match="code -15"):
        warm(trial.settings, tmp_path / "2", Work(trial))
    made_by(warm, trial.settings, tmp_path / "3", trial)
