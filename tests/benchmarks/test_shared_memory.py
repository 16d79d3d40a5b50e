"""The figures behind decision 48: what shared memory saves, and what it does not keep."""

from __future__ import annotations

import pytest

from benchmarks import shared_memory


def test_both_ways_are_measured_and_checked(capsys: pytest.CaptureFixture[str]) -> None:
    """Payloads arrive the way that is measured; the limit on a message's size does not hold in shared memory, and a
    killed sender leaves at least its three payloads' room behind: two of the reasons of decision 48."""
    assert shared_memory.main(["--size", "100000", "--messages", "2", "--rounds", "1"]) == 0
    out = capsys.readouterr().out
    assert "payloads of 100,000 bytes, 2 in each round" in out
    assert "| socket |" in out
    assert "| shared memory |" in out
    assert "Zenoh's limit on the size of a message does NOT hold for shared memory" in out
    left = int(out.partition("a killed sender leaves ")[2].partition(" bytes")[0].replace(",", ""))
    assert left >= 300_000
