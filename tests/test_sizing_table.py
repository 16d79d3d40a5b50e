"""The sizes in docs/operations.md are what the code says."""

from __future__ import annotations

import pytest

from common.config.settings import RunSettings
from reskpn.doctor.needs import UPDATE_BYTES
from scripts.document_sizing import PAGE, page, table


def test_the_table_is_current() -> None:
    """It is the one that `python -m scripts.document_sizing` writes."""
    text = PAGE.read_text()
    assert text == page(text)


def test_a_row_by_hand() -> None:
    """Hopper, 2 actors of 1,024 environments and 10 steps: 66 bytes a step and some for all else."""
    # 11 observations, 3 actions, log-probability and reward: 16 numbers of 4 bytes, and 2 flags: 66 bytes. For each
    # environment the last observation, 44 bytes a rollout: 4.4 a step. 600 bytes a rollout and 8,000 an update of
    # 20,480 steps are 0.06 and 0.4 more: 70.8.
    (row,) = [line for line in table().splitlines() if line.startswith("| `hopper`")]
    assert row == "| `hopper` | 18 | 71 | 0.72 MB | 0.07 GB |"
    assert (RunSettings().num_envs, RunSettings().num_steps, UPDATE_BYTES) == (2048, 10, 8000)


def test_a_page_without_a_place_for_it() -> None:
    """Is told, not overwritten."""
    with pytest.raises(ValueError, match="lacks"):
        page("# Operations\n")
