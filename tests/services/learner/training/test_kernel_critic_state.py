"""The kernel critic in a learner's state: kept by checkpoints, unseen by actors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from common.config.settings import RunSettings
from common.errors import CodecError
from services.learner.training.trainer import Trainer


def trainer(**critic: Any) -> Trainer:
    sizes = {
        "num_envs": 4,
        "num_steps": 4,
        "actors": 1,
        "total_steps": 16,
        "algorithm": {"hidden": (8,), "minibatches": 2},
    }
    return Trainer(RunSettings.model_validate({"learner": "dpo", "critic": critic} | sizes))


def test_a_checkpoint_holds_it_whole() -> None:
    """Frequencies, weights and equations come back from the arrays of a state; the digest covers them."""
    first, second = (trainer(representation="rff", capacity=8) for _ in range(2))
    arrays = first.state_arrays()
    kept = {name: array.shape for name, array in arrays.items() if name.startswith("critic/")}
    assert kept == {
        "critic/points/directions": (4, 8),
        "critic/points/whitening": (0, 0),
        "critic/weights": (8,),
        "critic/equations/matrix": (2, 8, 8),
        "critic/equations/right": (2, 8),
        "critic/equations/square": (2,),
    }
    changed = arrays | {"critic/weights": np.arange(8, dtype=np.float32)}
    second.restore(changed)
    np.testing.assert_array_equal(second.state_arrays()["critic/weights"], np.arange(8))
    assert second.digest() != first.digest()


def test_actors_do_not_carry_it() -> None:
    """A policy's arrays are the same with and without it: acting needs no values."""
    assert trainer(representation="rff", capacity=8).policy_arrays().keys() == trainer().policy_arrays().keys()


def test_a_checkpoint_of_a_run_without_it_does_not_fit() -> None:
    """Its arrays are named as missing, not made up."""
    with pytest.raises(CodecError, match="critic/"):
        trainer(representation="linear").restore(trainer().state_arrays())
