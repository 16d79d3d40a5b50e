"""Every built-in task packed for `reskpn play`: the simulation in the file is the environment."""

from __future__ import annotations

import pytest

from common.tasks import BUILT_IN
from tests.portable_tasks import check_portable


@pytest.mark.parametrize("task", BUILT_IN)
def test_a_portable_task_is_the_task(task: str) -> None:
    """Twelve steps."""
    check_portable(task)
