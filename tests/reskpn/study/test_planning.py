"""Trials of an experiment, and settings that other results decide."""

from __future__ import annotations

from common.config.presets import default_settings
from reskpn.study.experiments import Experiment, ScaleOverride
from reskpn.study.planning import plan
from reskpn.study.store import Store
from tests.reskpn.study.made_up import fill


def test_trials_are_by_seed_then_task_then_arm(catalogue: dict[str, Experiment], store: Store) -> None:
    """So that what is stopped early has all arms with as many seeds each."""
    trials = plan(catalogue["rates"], "smoke", catalogue, store).trials
    assert [(t.settings.seed, t.settings.task, t.arm) for t in trials] == [
        (seed, task, arm) for seed in (0, 1) for task in ("hopper", "reacher") for arm in ("slow", "fast")
    ]


def test_a_scale_decides_the_size_of_runs(catalogue: dict[str, Experiment], store: Store) -> None:
    """Laptop: 2e6 steps, 3e6 where episodes have 1,000 steps; the arm's own settings stay."""
    trials = plan(catalogue["rates"], "laptop", catalogue, store).trials
    steps = {trial.settings.task: trial.settings.total_steps for trial in trials}
    assert steps == {"hopper": 2_000_000, "reacher": 3_000_000}
    assert {t.arm: t.settings.algorithm.learning_rate for t in trials} == {"slow": 1e-4, "fast": 1e-3}
    assert {trial.settings.physics for trial in trials} == {"native"}


def test_a_scale_may_leave_arms_out(catalogue: dict[str, Experiment], store: Store) -> None:
    """At smoke scale, of arms that differ in one number; at the others all are there."""
    fewer = {"smoke": ScaleOverride(arms=("fast",))}
    experiment = catalogue["rates"].model_copy(update={"scales": fewer})
    assert {trial.arm for trial in plan(experiment, "smoke", catalogue, store).trials} == {"fast"}
    assert {trial.arm for trial in plan(experiment, "laptop", catalogue, store).trials} == {"slow", "fast"}


def test_arms_wait_for_the_results_that_decide_them(catalogue: dict[str, Experiment], store: Store) -> None:
    """Until all of them are there, an arm has no trials."""
    rates = plan(catalogue["rates"], "smoke", catalogue, store).trials
    fill(store, rates, missing=1)
    waiting = plan(catalogue["choice"], "smoke", catalogue, store)
    assert waiting.undecided == {"tuned": "rates", "star": "widths"}
    assert {trial.arm for trial in waiting.trials} == {"kpn"}


def test_results_decide_settings(catalogue: dict[str, Experiment], store: Store) -> None:
    """`fill` makes the later arm the better one, and spreads with variances 1 and 0.25: sigma* squared is 4."""
    fill(store, plan(catalogue["rates"], "smoke", catalogue, store).trials)
    fill(store, plan(catalogue["widths"], "smoke", catalogue, store).trials)
    planned = plan(catalogue["choice"], "smoke", catalogue, store)
    by_arm = {trial.arm: trial.settings for trial in planned.trials}
    assert planned.undecided == {}
    assert (by_arm["tuned"].learner, by_arm["tuned"].algorithm.learning_rate) == ("dpo", 1e-3)
    assert (by_arm["star"].learner, by_arm["star"].rkhs.bandwidth) == ("origin-kernel", 4.0)


def test_an_arm_may_stand_on_the_default_preset(catalogue: dict[str, Experiment], store: Store) -> None:
    """Its own learner has all of it, another one the sizes; beside them an arm without has Table 1."""
    experiment = Experiment.model_validate(
        {
            "name": "both",
            "title": "both",
            "tasks": ["hopper"],
            "arms": {
                "ours": {"base": "default"},
                "sizes": {"base": "default", "learner": "dpo"},
                "paper": {"learner": "dpo"},
                "wider": {"base": "default", "settings": {"rkhs.bandwidth": 5.0}},
            },
            "drawing": {"kind": "scores"},
        }
    )
    trials = plan(experiment, "laptop", catalogue | {"both": experiment}, store).trials
    by_arm = {trial.arm: trial.settings for trial in trials}
    default = default_settings()
    assert by_arm["ours"].rkhs.representation == default.rkhs.representation != "exact"
    assert by_arm["ours"].critic == by_arm["wider"].critic == default.critic
    assert by_arm["wider"].rkhs == default.rkhs.model_copy(update={"bandwidth": 5.0, "variance_every": 2})
    assert (by_arm["sizes"].learner, by_arm["sizes"].num_envs) == ("dpo", default.num_envs)
    assert by_arm["sizes"].critic.representation == "none"
    assert (by_arm["paper"].num_envs, by_arm["paper"].num_steps) == (2048, 10)
