"""What the log costs, and whether memory grows: the benchmarks measure what they say."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import log, memory
from common.errors import ProcessError


def test_growth_is_the_slope_after_the_first_fifth() -> None:
    """From 100 MB on 1 MB more every 10 s; what was before, while things were compiled, does not count."""
    times = [10.0 * n for n in range(10)]
    found = memory.growth(times, [900.0, 20.0, *(100.0 + n for n in range(8))])
    assert (found.first, found.last, found.least, found.most, found.samples) == (100.0, 107.0, 100.0, 107.0, 8)
    assert found.an_hour == pytest.approx(360.0)
    with pytest.raises(ProcessError, match="give more --minutes"):
        memory.growth(times[:2], [1.0, 2.0])


def test_growth_is_not_that_of_a_single_sample() -> None:
    """Of 40 counted samples the first and last four decide: one that is high for a moment shows in `most` alone."""
    values = [100.0] * 49 + [190.0]
    found = memory.growth([5.0 * n for n in range(50)], values)
    assert (found.first, found.last, found.most, found.samples) == (100.0, 100.0, 190.0, 40)
    assert found.series == values


def test_services_are_found_among_the_children() -> None:
    """By the words of their command line; other children are none."""
    program = "import sys; print(flush=True); sys.stdin.read()"
    names = ("learner", "actor", "actor", "evaluator")
    started = [
        subprocess.Popen([sys.executable, "-c", program, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for name in names
    ]
    try:
        for process in started:
            assert process.stdout is not None
            process.stdout.readline()
        found = memory.services(os.getpid())
        assert found == {"learner": started[0].pid, "actor 0": started[1].pid, "actor 1": started[2].pid}
        assert all(memory.resident_mb(pid) > 1.0 for pid in found.values())
    finally:
        for process in started:
            process.kill()
            process.communicate()


def test_the_cost_of_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All figures of a short measurement are there, and the log it wrote is gone."""
    options = ["--seconds", "0.2", "--rounds", "2", "--message", "0.1", "--rate", "10", "--folder", str(tmp_path)]
    assert log.main([*options, "--json", str(tmp_path / "x.json")]) == 0
    figures = json.loads((tmp_path / "x.json").read_text())["figures"]
    assert len(figures["shares"]) == 2
    assert 0.0 < figures["at_work"] < 1.0
    assert figures["reading_gb_s"] > 0.0
    assert "cores used by the log" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]
