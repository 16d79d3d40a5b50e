"""Whole runs of `reskpn train` that are disturbed, or in async mode: a start and a compilation for each."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from common.log.reader import LogReader
from common.wire.rollout import Rollout
from tests.integration.small_runs import ACTORS, replayed_digests, small_run, used_rollouts

pytestmark = pytest.mark.timeout(400)


def test_async_mode(tmp_path: Path) -> None:
    """Actors work on while the learner updates: every update takes the next rollouts of the log, none older than the
    bound, and the states follow from the log as in sync mode.
    """
    with small_run(tmp_path / "run", "--mode", "async", "--max-staleness", "2", updates=40) as training:
        code, output = training.finish()
    assert code == 0, output
    updates = used_rollouts(training.run_dir)
    assert len(updates) == 40
    behind = [[version - rollout.policy_version for rollout in used] for version, used in enumerate(updates)]
    assert all(0 <= number <= 2 for numbers in behind for number in numbers)
    assert max(map(max, behind)) > 0
    assert [update["staleness"] for update in training.updates()] == [
        {"min": min(numbers), "mean": sum(numbers) / ACTORS, "max": max(numbers)} for numbers in behind
    ]
    logged = [Rollout.decode(message.data).key for message in LogReader(training.run_dir).messages(["/rollout"])]
    for version, used in enumerate(updates):
        assert {rollout.key for rollout in used} == set(logged[ACTORS * version : ACTORS * (version + 1)])
        assert [rollout.id for rollout in used] == sorted(rollout.id for rollout in used)
    assert replayed_digests(training.run_dir)[-1] == training.summary["state_digest"]


def test_killed_actor_does_not_stop_a_run(tmp_path: Path) -> None:
    """With an actor killed midway the run completes, and every update still used whole rollouts of its version."""
    with small_run(tmp_path / "run", updates=150) as training:
        training.wait_for(lambda: len(training.updates()) >= 5)
        os.kill(training.children()["actor"][0], signal.SIGKILL)
        code, output = training.finish()
    assert code == 0, output
    assert "restarting it" in output
    assert training.summary["updates"] == 150
    events = [message.json()["name"] for message in LogReader(training.run_dir).messages(["/event"])]
    assert "actor_lost" in events
    for version, rollouts in enumerate(used_rollouts(training.run_dir)):
        assert len(rollouts) == ACTORS
        assert {rollout.policy_version for rollout in rollouts} == {version}
    assert replayed_digests(training.run_dir)[-1] == training.summary["state_digest"]


def test_ctrl_c_ends_cleanly(tmp_path: Path) -> None:
    """Ctrl-C: exit code 130, a finished log with all that was used, a summary that says so, no process left."""
    with small_run(tmp_path / "run", updates=100_000) as training:
        training.wait_for(lambda: len(training.updates()) >= 3)
        processes = [pid for pids in training.children().values() for pid in pids]
        assert len(processes) == 1 + ACTORS
        training.process.send_signal(signal.SIGINT)
        code, output = training.finish()
    assert code == 130, output
    summary = training.summary
    assert summary["complete"] is False
    assert summary["eval_return_mean"] is None
    reader = LogReader(training.run_dir)
    assert not reader.torn
    assert reader.counts()["/update"] == summary["updates"]
    assert not [pid for pid in processes if Path(f"/proc/{pid}").exists()]


def test_dead_learner_ends_the_run(tmp_path: Path) -> None:
    """A learner that is killed takes the run with it: an exit code that says so, and no actor left behind."""
    with small_run(tmp_path / "run", updates=100_000) as training:
        training.wait_for(lambda: len(training.updates()) >= 3)
        children = training.children()
        os.kill(children["learner"][0], signal.SIGKILL)
        code, output = training.finish()
    assert code == 128 + signal.SIGKILL, output
    assert not (training.run_dir / "summary.json").exists()
    assert not [pid for pid in children["actor"] if Path(f"/proc/{pid}").exists()]
    # What was written is whole: the states follow from it.
    logged = [update["state_digest"] for update in training.updates()]
    assert replayed_digests(training.run_dir)[: len(logged)] == logged
