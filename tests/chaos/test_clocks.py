"""The wall clock is for people: nothing that a run does depends on it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from common.log.reader import LogReader
from tests.chaos.interruptions import OPTIONS, UPDATES, Apart, Processes, audited

pytestmark = pytest.mark.timeout(400)

HOUR_S = 3600
UPDATE = "services.learner.training.trainer:Trainer.update"
COLLECT = "services.actor.collector:Collector.collect"


def test_the_clock_jumps(
    started: Processes, tmp_path: Path, undisturbed: list[str], found: Callable[[str], None]
) -> None:
    """The wall clock jumps by an hour, forth and back, in the learner and in an actor: nobody is given up, and the run
    ends in the same state."""
    run_dir = tmp_path / "run"
    apart = Apart(
        started,
        run_dir,
        OPTIONS,
        learner_faults=[f"jump {HOUR_S} {UPDATE} 20", f"jump {-2 * HOUR_S} {UPDATE} 40"],
        actor_faults=([f"jump {-HOUR_S} {COLLECT} 15", f"jump {2 * HOUR_S} {COLLECT} 45"], []),
    )
    assert apart.end().count("fault: the clock jumps") == 2
    assert audited(run_dir, UPDATES) == undisturbed
    messages = list(LogReader(run_dir).messages())
    assert not [message for message in messages if message.topic == "/event" and message.json()["name"] == "actor_lost"]
    # The jumps are in the log's own times: on by an hour, and back by two.
    jumps = [round((new.t_ns - old.t_ns) / 1e9 / HOUR_S) for old, new in pairwise(messages)]
    assert [hours for hours in jumps if hours] == [1, -2]
    found(f"+1 h and -2 h in the learner, -1 h and +2 h in an actor: {UPDATES} of {UPDATES} digests equal")
