"""A catalogue of two small experiments and a folder for their results."""

from __future__ import annotations

from pathlib import Path

import pytest

from reskpn.study.experiments import Experiment, parse_experiment
from reskpn.study.store import Store

RATES = """
title: Learning rates
tasks: [hopper, reacher]
arms:
  slow: {learner: dpo, label: Slow, settings: {algorithm.learning_rate: 1.0e-4}}
  fast: {learner: dpo, label: Fast, settings: {algorithm.learning_rate: 1.0e-3}}
drawing: {kind: scores}
scales:
  smoke: {tasks: [hopper, reacher], seeds: 2}
"""

CHOICE = """
title: The best of them
tasks: [hopper]
arms:
  kpn: {learner: kpn, label: KPN}
  tuned: {label: Tuned, best_of: {experiment: rates, arms: [slow, fast]}}
  star: {learner: origin-kernel, label: Star, width_of: widths}
drawing: {kind: curves}
"""

WIDTHS = """
title: Spreads
tasks: [hopper]
arms:
  kpn: {learner: kpn, label: KPN}
drawing: {kind: spreads}
"""


@pytest.fixture
def catalogue() -> dict[str, Experiment]:
    texts = {"rates": RATES, "choice": CHOICE, "widths": WIDTHS}
    return {name: parse_experiment(name, text) for name, text in texts.items()}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "results")
