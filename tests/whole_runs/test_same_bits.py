"""A run made twice: the seed decides, and nothing of its processes or their timing."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.small_runs import Training, small_run

pytestmark = pytest.mark.timeout(400)  # three processes load and compile for each run


def test_same_seed_same_bits(tmp_path: Path) -> None:
    """Sync mode: the same seed and number of actors end in the same state."""

    def made(name: str) -> Training:
        with small_run(tmp_path / name, updates=12) as training:
            code, output = training.finish()
        assert code == 0, output
        return training

    first, again = made("a"), made("again")
    assert again.summary["state_digest"] == first.summary["state_digest"]
    assert again.summary["eval_return_mean"] == first.summary["eval_return_mean"]
