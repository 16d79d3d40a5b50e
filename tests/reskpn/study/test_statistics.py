"""Statistics, against worked examples."""

from __future__ import annotations

import numpy as np
import pytest

from reskpn.study.statistics import (
    Estimate,
    bootstrap,
    improvement,
    interquartile_mean,
    mean,
    mean_interval,
    normalised,
    performance_profile,
    pooled,
    probability_of_improvement,
)


def test_the_interquartile_mean_cuts_a_quarter_at_each_end() -> None:
    """Of 1..8 the two lowest and the two highest go: (3 + 4 + 5 + 6) / 4 = 4.5. A wild run changes nothing."""
    assert interquartile_mean(np.arange(1.0, 9.0)) == 4.5
    assert interquartile_mean(np.array([1.0, 2, 3, 4, 5, 6, 7, 1e9])) == 4.5


def test_the_interquartile_mean_is_of_all_runs_of_all_tasks() -> None:
    """Runs 0, 4 of one task and 1, 2 of the other are pooled: the middle half of 0, 1, 2, 4 is 1, 2."""
    assert interquartile_mean(pooled({"a": np.array([0.0, 4.0]), "b": np.array([1.0, 2.0])})) == 1.5


def test_the_interval_resamples_within_tasks() -> None:
    """Two tasks whose runs are alike have no spread, however far apart the tasks are."""
    estimate = bootstrap({"a": np.array([1.0, 1.0]), "b": np.array([9.0, 9.0])}, mean)
    assert estimate == Estimate(5.0, 5.0, 5.0)


def test_the_interval_covers_as_often_as_it_says() -> None:
    """Of 200 samples of 30 standard normal runs, the 95% interval of the mean holds 0 in about 190 (bootstrap: 93%)."""
    random = np.random.default_rng(1)
    estimates = [bootstrap({"a": random.standard_normal(30)}, mean, resamples=400, seed=i) for i in range(200)]
    held = sum(estimate.low <= 0 <= estimate.high for estimate in estimates)
    assert 178 <= held <= 198


def test_the_probability_of_improvement_counts_pairs() -> None:
    """On a: 3 beats 1 and 2, 1 ties with 1 and loses to 2: (2 + 1/2) / 4. On b all are better: 1. Mean: 0.8125."""
    x = {"a": np.array([1.0, 3.0]), "b": np.array([5.0])}
    y = {"a": np.array([1.0, 2.0]), "b": np.array([4.0, 3.0])}
    assert probability_of_improvement(x, y) == pytest.approx((0.625 + 1.0) / 2)
    assert probability_of_improvement(y, x) == pytest.approx(1 - (0.625 + 1.0) / 2)


def test_improvement_has_an_interval_between_0_and_1() -> None:
    """That of a group on itself holds one half."""
    runs = {"a": np.array([1.0, 2.0, 3.0, 4.0]), "b": np.array([5.0, 6.0, 8.0])}
    estimate = improvement(runs, runs)
    assert estimate.value == 0.5
    assert 0 <= estimate.low < 0.5 < estimate.high <= 1


def test_a_profile_is_the_share_of_runs_above() -> None:
    """Task a has runs 0, 2 and task b has 1, 1: above 0.5 are 1/2 and 1, above 1 are 1/2 and 0, above 2 none."""
    scores = {"a": np.array([0.0, 2.0]), "b": np.array([1.0, 1.0])}
    assert performance_profile(scores, np.array([0.5, 1.0, 2.0])).tolist() == [0.75, 0.25, 0.0]


def test_normalised_scores_have_the_start_at_0_and_the_reference_at_1() -> None:
    """Also where returns are negative: from -10, with a reference at -2, a run at -4 is at 6/8."""
    scores = normalised({"reacher": np.array([-4.0])}, {"reacher": -10.0}, {"reacher": -2.0})
    assert scores["reacher"].tolist() == [0.75]


def test_one_curve_has_no_spread() -> None:
    """The interval of the mean of one run is the run."""
    low, high = mean_interval(np.array([[1.0, 2.0]]))
    assert low.tolist() == high.tolist() == [1.0, 2.0]
