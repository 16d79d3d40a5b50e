"""Making the runs that are missing: stopped, failed and given again."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from common.config.settings import RunSettings
from common.errors import LogWriteError, ProcessError, SettingsError
from reskpn.study.experiments import Experiment
from reskpn.study.planning import plan
from reskpn.study.running import Progress, Work, check_exit, run_missing
from reskpn.study.session import make_runs
from reskpn.study.store import Store
from reskpn.study.writing import write_result
from tests.reskpn.study.made_up import made_up


class Runner:
    """Writes made-up results; the run number `breaks_at` raises `error` instead."""

    def __init__(self, breaks_at: int = -1, error: Exception | None = None) -> None:
        self.made: list[RunSettings] = []
        self._breaks_at = breaks_at
        self._error = error

    def __call__(self, settings: RunSettings, path: Path, work: Work) -> None:
        self.made.append(settings)
        if self._error is not None and len(self.made) == self._breaks_at:
            raise self._error
        write_result(made_up(settings), path)


def test_only_what_is_missing_is_made(catalogue: dict[str, Experiment], store: Store) -> None:
    """The second time nothing is, and of a run that two experiments have only one is made."""
    trials = plan(catalogue["rates"], "smoke", catalogue, store).trials
    runner, said = Runner(), []
    assert run_missing([*trials, *trials], store, jobs=1, say=said.append, runner=runner) == 8
    assert run_missing(trials, Store(store.folder), jobs=1, say=said.append, runner=runner) == 0
    assert len(runner.made) == 8
    assert sum(line.startswith("[") for line in said) == 8


@pytest.mark.parametrize("stop_at", [1, 4, 8])
def test_nothing_finished_is_lost_to_a_full_disk(catalogue: dict[str, Experiment], store: Store, stop_at: int) -> None:
    """No further run is begun; given again, the command makes the rest and each run exactly once."""
    trials = plan(catalogue["rates"], "smoke", catalogue, store).trials
    full = Runner(stop_at, LogWriteError("no space left"))
    with pytest.raises(LogWriteError, match="no space left"):
        run_missing(trials, store, jobs=1, say=lambda text: None, runner=full)
    assert len(full.made) == stop_at
    rest = Runner()
    assert run_missing(trials, Store(store.folder), jobs=2, say=lambda text: None, runner=rest) == 8 - (stop_at - 1)
    assert len(Store(store.folder)) == 8


def test_a_run_that_fails_does_not_stop_the_others(catalogue: dict[str, Experiment], store: Store) -> None:
    """At the end one sentence names it."""
    trials = plan(catalogue["rates"], "smoke", catalogue, store).trials
    with pytest.raises(ProcessError, match=r"1 of 8 runs failed: fast on hopper, seed 0 \(update 3 .*\)"):
        run_missing(trials, store, jobs=1, say=lambda text: None, runner=Runner(2, ProcessError("update 3 broke")))
    assert len(store) == 7


def test_results_that_decide_others_are_made_first(catalogue: dict[str, Experiment], store: Store) -> None:
    """One command makes all: rates and spreads, then the arms that they decide."""
    runner, said = Runner(), []
    made = make_runs(["choice"], "smoke", catalogue, store, only={}, jobs=1, say=said.append, runner=runner)
    assert made == len(runner.made) == len(store)
    assert plan(catalogue["choice"], "smoke", catalogue, store).undecided == {}
    assert runner.made[-1].learner == "origin-kernel"


def test_some_tasks_and_seeds_alone(catalogue: dict[str, Experiment], store: Store) -> None:
    """What is left out may leave arms undecided, which is said."""
    said: list[str] = []
    only = {"task": ["hopper"], "seed": [0]}
    make_runs(["choice"], "smoke", catalogue, store, only=only, jobs=1, say=said.append, runner=Runner())
    assert {result.seed for result in store._results.values()} == {0}
    assert "tuned waits for results of rates that this command left out" in said


def test_some_arms_alone(catalogue: dict[str, Experiment], store: Store) -> None:
    """Of `rates`, two tasks with two seeds of the one arm; one that is not there is refused with the nearest name."""
    runner = Runner()
    made = make_runs(["rates"], "smoke", catalogue, store, only={"arm": ["fast"]}, jobs=1, say=print, runner=runner)
    assert made == 4
    assert {settings.algorithm.learning_rate for settings in runner.made} == {1e-3}
    with pytest.raises(SettingsError, match=r"'fats' is not an arm; did you mean 'fast'\?"):
        make_runs(["rates"], "smoke", catalogue, store, only={"arm": ["fats"]}, jobs=1, say=print, runner=runner)


def test_the_time_left_is_at_the_pace_so_far() -> None:
    """A quarter of the steps in 600 s leaves 1,800 s; none made says nothing."""
    progress = Progress(total_steps=4000)
    assert progress.left(0) == "time left unknown"
    progress.began_s -= 600
    progress.finished_steps = 500
    assert progress.left(500) == "30 min left"
    assert Progress(4000, progress.began_s, 100).left(0) == "6 h 30 min left"


def test_how_a_run_ended_decides_the_error() -> None:
    """The last line it said, or its exit code where it said nothing."""
    check_exit(0, [])
    with pytest.raises(LogWriteError, match="disk full"):
        check_exit(5, ["warning\n", "disk full\n"])
    with pytest.raises(ProcessError, match="ended with code -9"):
        check_exit(-9, [])


@pytest.mark.usefixtures("in_a_hurry")
def test_a_real_run_leaves_a_result(
    catalogue: dict[str, Experiment], store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lean driver trains and evaluates in a few updates, and reports them."""
    from reskpn.study import one_run

    monkeypatch.setattr(one_run, "prepare", lambda: None)  # the tests have prepared JAX
    trial = plan(catalogue["widths"], "smoke", catalogue, store).trials[0]
    small = {"total_steps": 3 * 64, "num_envs": 8, "num_steps": 8, "episode_length": 10, "evaluation": {"episodes": 2}}
    settings = RunSettings.model_validate(trial.settings.model_dump() | small)
    result = one_run.run(settings)
    assert result.curve["env_steps"] == [64.0, 128.0, 192.0]
    assert sum(count or 0 for count in result.curve["episodes"]) >= 16  # 8 environments, 24 steps, episodes of 10
    assert result.scores.evaluation is not None
    assert (len(result.spreads["observations"]), len(result.spreads["features"])) == (11, 16)
    assert result.engine == "native"
    assert sys.version.startswith(result.versions["python"])
