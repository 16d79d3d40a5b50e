"""A short soak; `python -m tests.chaos.soak --minutes 60` makes a long one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.chaos.interruptions import SEED
from tests.chaos.soak import LIMIT_BYTES, LIMIT_S, soak


@pytest.mark.timeout(900)
def test_wrong_messages_of_every_kind_and_role(tmp_path: Path, found: Callable[[str], None]) -> None:
    """Mutated messages from an actor in its slot and from strangers change no digest, take less than 64 MB, and leave
    every question for the status answered within a second."""
    soaked = soak(tmp_path, minutes=0.4, seed=SEED)
    found(f"seed {SEED}: {soaked}")
    assert soaked.equal
    assert soaked.most - soaked.before < LIMIT_BYTES
    assert soaked.failures == []
    assert soaked.slowest_s < LIMIT_S
