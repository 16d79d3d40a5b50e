"""All runs of some experiments, in the order in which their results decide each other's settings."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from common.errors import SettingsError
from common.suggestions import unknown_name
from common.tasks import task_fault
from reskpn.study.experiments import Experiment
from reskpn.study.planning import Trial, plan, with_needs
from reskpn.study.running import Runner, Say, run_missing
from reskpn.study.store import Store


def make_runs(
    names: list[str],
    scale: str,
    catalogue: Mapping[str, Experiment],
    store: Store,
    *,
    only: Mapping[str, Collection[Any]],
    jobs: int,
    say: Say,
    runner: Runner,
) -> int:
    """Make the missing runs of these experiments and of those that they need; returns how many were made.

    Args:
        only: values that "task", "seed" and "arm" of a trial must be among; other trials are left out.

    Raises:
        SettingsError: an unknown experiment, arm, scale, task or setting, or arms that remain undecided.
        LogWriteError, ProcessError: as `run_missing`.
    """
    for task in only.get("task", ()):
        if (fault := task_fault(task, None)) is not None:
            raise SettingsError(fault)
    experiments = [experiment for experiment in with_needs(names, catalogue) if experiment.needs_runs]
    arms = dict.fromkeys(arm for experiment in experiments for arm in experiment.arms)
    for arm in only.get("arm", ()):
        if arm not in arms:
            raise SettingsError(unknown_name("arm", arm, arms))
    made = 0
    while True:
        plans = {
            experiment.name: plan(experiment, scale, catalogue, store)
            for experiment in experiments
            if experiment.needs_runs
        }
        wanted = [trial for planned in plans.values() for trial in planned.trials if _is_wanted(trial, only)]
        new = run_missing(
            sorted(wanted, key=lambda trial: trial.settings.seed), store, jobs=jobs, say=say, runner=runner
        )
        made += new
        undecided = {arm: needed for planned in plans.values() for arm, needed in planned.undecided.items()}
        if not undecided or not new:
            break
    for arm, needed in undecided.items():
        say(f"{arm} waits for results of {needed} that this command left out")
    return made


def _is_wanted(trial: Trial, only: Mapping[str, Collection[Any]]) -> bool:
    found = {"task": trial.settings.task, "seed": trial.settings.seed, "arm": trial.arm}
    return all(found[name] in values for name, values in only.items())
