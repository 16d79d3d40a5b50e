"""Tables of an experiment, as Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.config.settings import RunSettings
from common.errors import LogWriteError
from common.learners import LEARNERS
from common.remedies import remedy
from reskpn.study.groups import Group, starting_score
from reskpn.study.results import Result
from reskpn.study.scoring import area_of, final_of
from reskpn.study.statistics import (
    Strata,
    bootstrap,
    improvement,
    interquartile_mean,
    mean,
    normalised,
    pooled,
)

FULL_STEPS = 5e7
"""Environment steps of the paper's runs."""

ALL = "all tasks"


@dataclass(frozen=True)
class Table:
    """A header and rows of cells; `note` says what the numbers are."""

    header: list[str]
    rows: list[list[str]]
    note: str

    def markdown(self) -> str:
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        text = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        return f"{text}\n\n{self.note}\n"

    def csv(self) -> str:
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([self.header, *self.rows])
        return out.getvalue()


def write_text(path: Path, text: str) -> Path:
    """Write a file whole; LogWriteError where it cannot be written."""
    beside = path.with_suffix(path.suffix + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        raise LogWriteError(f"{path} cannot be written ({error.strerror or error}); {remedy(error)} (--out)") from None
    return path


def score_table(groups: Sequence[Group], tasks: Sequence[str], score: Callable[[Result], float] = final_of) -> Table:
    """Mean score by arm and task with its 95% interval, and how many runs it is of."""
    what = "over the last tenth of the run" if score is final_of else "over the whole run"
    rows = []
    for each in groups:
        scores = each.scores(score)
        rows.append([each.label, *(_interval({task: scores[task]}) if task in scores else "-" for task in tasks)])
    note = (
        f"Mean training return {what}, with the 95% bootstrap interval of the mean over seeds and the number of runs. "
        "Where no episode terminates (halfcheetah, humanoidstandup, pusher, reacher): mean reward of a step times "
        "1,000."
    )
    return Table(["", *tasks], rows, note)


def aggregate_table(groups: Sequence[Group], reference: Group) -> Table | None:
    """Interquartile means over all tasks, normalised, and the probability of improvement on the reference arm.

    None where `comparable` leaves no two of several groups.
    """
    every, (groups, reference) = groups, comparable(groups, reference)
    strata = aggregates(groups, reference)
    if strata is None or (len(groups) < 2 <= len(every)):
        return None
    rows = []
    for each in groups:
        cells = [format(bootstrap(strata[kind][each.name], interquartile_mean), ".2f") for kind in ("final", "area")]
        better = improvement(strata["final"][each.name], strata["final"][reference.name])
        rows.append([each.label, *cells, "-" if each is reference else format(better, ".2f")])
    tasks = sorted(strata["final"][reference.name])
    note = (
        "Interquartile mean over the runs of all tasks with its stratified 95% bootstrap interval, in units in which "
        f"an untrained policy has 0 and the mean of {reference.label} has 1 on each task; the probability that a run "
        f"is better than one of {reference.label}, the mean over tasks. Tasks: {', '.join(tasks)}."
    )
    if left_out := [each.label for each in every if each not in groups]:
        note += f" Left out, without runs of all of these: {', '.join(left_out)}."
    return Table(["", "last tenth", "area", f"P(better than {reference.label})"], rows, note)


def comparable(groups: Sequence[Group], reference: Group) -> tuple[list[Group], Group]:
    """The arms to compare over all tasks, and the one that the others are measured by.

    All arms, where they have a task in common. Else those with runs of every task of the arm that has most, which is
    the reference then: in a study that is half made, some arms may have been begun on other tasks.
    """
    if any(all(each.results.get(task) for each in groups) for task in reference.results):
        return list(groups), reference
    widest = max(groups, key=lambda each: len(_tasks_of(each)))
    return [each for each in groups if _tasks_of(widest) <= _tasks_of(each)], widest


def _tasks_of(group: Group) -> set[str]:
    return {task for task, runs in group.results.items() if runs}


def aggregates(groups: Sequence[Group], reference: Group) -> dict[str, dict[str, Strata]] | None:
    """Normalised scores by kind ("final", "area"), arm and task, on the tasks that all groups have runs of."""
    shared = [task for task in reference.results if all(each.results.get(task) for each in groups)]
    if not shared:
        return None
    start = starting_score(groups)
    found: dict[str, dict[str, Strata]] = {}
    for kind, score in (("final", final_of), ("area", area_of)):
        unit = {task: float(np.mean(values)) for task, values in reference.scores(score).items()}
        shared = [task for task in shared if unit[task] != start[task]]
        found[kind] = {
            each.name: normalised({t: v for t, v in each.scores(score).items() if t in shared}, start, unit)
            for each in groups
        }
    return found if shared else None


def runtime_table(groups: Sequence[Group], tasks: Sequence[str]) -> Table:
    """Processor minutes of a run of the paper's length by arm and task, extrapolated from shorter runs."""

    def minutes(result: Result) -> float:
        steps = float(result.curve["env_steps"][-1] or 0)
        spent_s = result.timing.wall_s if result.timing.cpu_s is None else result.timing.cpu_s
        return spent_s / steps * FULL_STEPS / 60

    rows = []
    for each in groups:
        scores = each.scores(minutes)
        rows.append([each.label, *(f"{np.median(scores[task]):,.0f}" if task in scores else "-" for task in tasks)])
    note = (
        "Processor minutes (all cores together, so that other load on the machine does not count) of collecting and "
        "updating for 5e7 environment steps: the median of the runs, extrapolated from their own length."
    )
    return Table(["", *tasks], rows, note)


TABLE_1 = (
    ("Learning rate", "algorithm.learning_rate", "all"),
    ("Learning rate of h (eta)", "rkhs.eta", "rkhs"),
    ("Momentum of h", "rkhs.momentum", "rkhs"),
    ("Largest gradient norm", "algorithm.max_grad_norm", "all"),
    ("Environments", "num_envs", "all"),
    ("Steps an update", "num_steps", "all"),
    ("Environment steps in all", "total_steps", "all"),
    ("Minibatches", "algorithm.minibatches", "all"),
    ("Epochs", "algorithm.epochs", "all"),
    ("Discount", "algorithm.gamma", "all"),
    ("GAE lambda", "algorithm.gae_lambda", "all"),
    ("Clip", "algorithm.clip", "all"),
    ("Clip of h", "rkhs.clip", "rkhs"),
    ("DPO alpha", "algorithm.dpo_alpha", "dpo"),
    ("DPO beta", "algorithm.dpo_beta", "dpo"),
    ("DPO alpha of h", "rkhs.drift_alpha", "rkhs"),
    ("DPO beta of h", "rkhs.drift_beta", "rkhs"),
    ("Layers", "algorithm.hidden", "all"),
    ("Kernel", "rkhs.kernel", "rkhs"),
    ("Width of the kernel", "rkhs.bandwidth", "rkhs"),
    ("Transitions of a functional gradient", "rkhs.samples", "rkhs"),
)
"""Rows of Table 1: name, setting, and the learners that it concerns."""


def settings_table(arms: dict[str, RunSettings]) -> Table:
    """The settings of each arm; n/a where its learner does not use one."""
    trees = {label: settings.model_dump(mode="json") for label, settings in arms.items()}
    rows = [
        [name, *(_setting(trees[label], path) if _concerns(arms[label], who) else "n/a" for label in arms)]
        for name, path, who in TABLE_1
    ]
    return Table(["", *arms], rows, "Read from the settings of the experiments; n/a: the learner has no such part.")


def _concerns(settings: RunSettings, who: str) -> bool:
    learner = LEARNERS[settings.learner]
    if who == "rkhs":
        return learner.rkhs
    if who == "dpo":
        chosen = settings.algorithm.objective
        return (learner.objective if chosen == "auto" else chosen) == "dpo"
    return True


def _setting(tree: dict[str, Any], path: str) -> str:
    value: Any = tree
    for part in path.split("."):
        value = value[part]
    if isinstance(value, list):
        return " x ".join(str(each) for each in value)
    return f"{value:g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)


def _interval(scores: Strata) -> str:
    count = sum(len(values) for values in scores.values())
    if count == 1:
        return f"{pooled(scores)[0]:,.0f} (1)"
    estimate = bootstrap(scores, mean, resamples=1000)
    return f"{estimate:,.0f} ({count})"
