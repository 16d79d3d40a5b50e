"""Evaluators come and are killed beside a run, which is the same with and without them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from pathlib import Path

import pytest

from common.log.reader import LogReader
from tests.chaos.interruptions import UPDATES, Apart, Processes, audited, small_options, wait_for

pytestmark = pytest.mark.timeout(400)
EPISODES = 4


def evaluations(run_dir: Path) -> dict[str, list[int]]:
    """Versions in the log's `/eval` by source; none where there is no log yet."""
    found: dict[str, list[int]] = {}
    if list((run_dir / "log").glob("*.mcap")):
        for message in LogReader(run_dir).messages(["/eval"]):
            found.setdefault(message.json()["source"], []).append(message.json()["version"])
    return found


def test_evaluators_change_nothing(
    started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """With an evaluator that is killed and one that stays, a run ends in the state of one without any."""
    run_dir = tmp_path / "run"
    apart = Apart(started, run_dir, small_options(UPDATES, EPISODES), actor_faults=())
    words = ("evaluator", "--endpoint", apart.endpoint, "--physics", "native", "--threads", 1)
    evaluators = [started.start(*words, "--every", 1, "--episodes", EPISODES) for _ in range(2)]
    wait_for(lambda: len(evaluations(run_dir)) == 2, [apart.learner])
    evaluators[0].kill()
    # Only now are there actors, and with them the first update.
    apart.add_actor()
    apart.add_actor()
    apart.end()
    evaluators[1].end()
    assert audited(run_dir, UPDATES) == undisturbed
    by_source = evaluations(run_dir)
    assert by_source.pop("run") == [UPDATES]
    assert [versions[0] for versions in by_source.values()] == [0, 0]
    count = sum(map(len, by_source.values()))
    (curves,) = (run_dir / "tensorboard").iterdir()
    # One point a version, whichever evaluator was first; the run's own evaluation has a curve of its own.
    assert curves.read_bytes().count(b"eval/return_std") == len({*chain.from_iterable(by_source.values())})
    assert curves.read_bytes().count(b"final/return_std") == 1
    trajectories = list(LogReader(run_dir).messages(["/trajectory"]))
    assert len(trajectories) == count
    assert all(len(step["qpos"]) == 2 for message in trajectories for step in message.json()["steps"])
    found(f"{count} evaluations beside the run; {UPDATES} of {UPDATES} digests equal")
