"""A trainer, and a log of what it did, for the tests of replays."""

from __future__ import annotations

import pytest
from quick_compiler import quick_compiler
from recorded_runs import Recording, record, trainer_settings

from services.learner.training.trainer import Trainer


@pytest.fixture(autouse=True, scope="module")
def _everything_in_a_hurry(in_a_hurry: None) -> None:
    """For all tests of this folder: trainers compute the same bits."""


@pytest.fixture(scope="session")
def trainer() -> Trainer:
    """Compiled once; `Recording.start` puts it back to the beginning."""
    with quick_compiler():
        trainer = Trainer(trainer_settings())
        trainer.compile()
    return trainer


@pytest.fixture(scope="session")
def recording(trainer: Trainer) -> Recording:
    """Four updates of that trainer, as they are logged."""
    return record(trainer)
