"""A hundred thousand wrong messages; the figures are printed with `-s`."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from under_fire import memory_growth, siege


@pytest.mark.timeout(1800)
def test_a_hundred_thousand_wrong_messages(tmp_path: Path) -> None:
    """No exception leaves a handler, each is counted by its reason, and the process grows by less than 64 MB."""
    with siege(tmp_path / "log", seed=2026) as under:
        under.run(400)  # what is loaded and compiled once is no growth
        began_s = time.monotonic()
        with memory_growth() as growth:
            under.run(100_000)
            grown = growth()
        seconds = time.monotonic() - began_s
        under.check()
    print(f"\n{sum(under.sent.values()):,} messages in {seconds:.0f} s, memory grew by {grown / 1e6:.1f} MB at most")
    for kind, counts in sorted(under.refused.items()):
        print(f"{kind}: {under.sent[kind]:,} sent, {counts.total():,} refused: {dict(counts.most_common())}")
    print(f"rollouts: {dict(under.answers)}")
    assert grown < 64 << 20
