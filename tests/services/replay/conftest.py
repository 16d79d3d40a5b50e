"""A trainer, and a log of what it did, for the tests of replays."""

from __future__ import annotations

import pytest
from recorded_runs import Recording, record, trainer_settings

from services.learner.training.trainer import Trainer


@pytest.fixture(scope="session")
def trainer() -> Trainer:
    """Compiled once; `Recording.start` puts it back to the beginning."""
    trainer = Trainer(trainer_settings())
    trainer.compile()
    return trainer


@pytest.fixture(scope="session")
def recording(trainer: Trainer) -> Recording:
    """Four updates of that trainer, as they are logged."""
    return record(trainer)
