"""Traces of updates by JAX's profiler, and what is said where there is none."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from common.trace_plan import TracePlan
from services.learner.reporting.trace import UpdateTrace, phase


@pytest.fixture
def told() -> list[tuple[str, str, str]]:
    return []


def make_updates(trace: UpdateTrace, versions: range) -> None:
    """As the learner's loop does."""
    work = jax.jit(jnp.sum)
    with trace:
        for version in versions:
            with trace.update(version):
                with phase("wait"):
                    pass
                with phase("learner"):
                    work(jnp.ones(8)).block_until_ready()


def events(path: Path) -> list[dict[str, Any]]:
    """The named events of a trace that Perfetto opens."""
    content = json.loads(gzip.decompress(path.read_bytes()))
    return [event for event in content["traceEvents"] if event.get("ph") == "X"]


def test_the_planned_updates_are_traced_by_version_and_phase(tmp_path: Path, told: list[tuple[str, str, str]]) -> None:
    """Two of five: each phase lies within its update, and the event says where the file is."""
    make_updates(UpdateTrace(TracePlan(2), tmp_path / "trace", lambda *event: told.append(event)), range(1, 6))
    (path,) = tmp_path.rglob("perfetto_trace.json.gz")
    found = events(path)
    updates = [event for event in found if event["name"] == "update"]
    assert sorted(int(event["args"]["step_num"]) for event in updates) == [3, 4]
    for name in ("wait", "learner"):
        phases = [event for event in found if event["name"] == name]
        assert len(phases) == 2
        for inner, outer in zip(phases, updates, strict=True):
            assert outer["ts"] <= inner["ts"]
            assert inner["ts"] + inner["dur"] <= outer["ts"] + outer["dur"] + 1e-3
    ((level, name, text),) = told
    assert (level, name) == ("info", "traced")
    assert text == f"traced the updates to versions 3 to 4: open {path} in https://ui.perfetto.dev"


def test_a_trace_that_the_run_ends_is_written(tmp_path: Path, told: list[tuple[str, str, str]]) -> None:
    """With the updates that there were: one of ten."""
    make_updates(UpdateTrace(TracePlan(10, 2), tmp_path, lambda *event: told.append(event)), range(1, 3))
    assert [event[:2] for event in told] == [("info", "traced")]
    assert told[0][2].startswith("traced the updates to version 2: ")


def test_a_run_that_ends_before_is_said(tmp_path: Path, told: list[tuple[str, str, str]]) -> None:
    """Nobody looks for a file that is not there; without a plan there is nothing to say, and no folder."""
    make_updates(UpdateTrace(TracePlan(1, 9), tmp_path / "a", lambda *event: told.append(event)), range(1, 3))
    make_updates(UpdateTrace(None, tmp_path / "b", lambda *event: told.append(event)), range(1, 3))
    assert told == [("warning", "not_traced", "no update was traced: the run ended before --trace 1@9 was due")]
    assert list(tmp_path.iterdir()) == []


def test_a_trace_that_cannot_be_written_does_not_end_the_run(tmp_path: Path, told: list[tuple[str, str, str]]) -> None:
    """All updates are made; the reason is an event, once."""
    (tmp_path / "trace").write_text("a file in its place")
    make_updates(UpdateTrace(TracePlan(1, 1), tmp_path / "trace", lambda *event: told.append(event)), range(1, 5))
    assert [event[:2] for event in told] == [("warning", "trace_failed")]
    assert "File exists" in told[0][2]
